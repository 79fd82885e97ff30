"""Equations as MathML, by docutils: every browser draws it, and no script comes from elsewhere."""

from docutils.utils.math.latex2mathml import tex2mathml


def _inline(writer, node):
    writer.body.append(tex2mathml(node.astext(), as_block=False))
    _skip()


def _block(writer, node):
    writer.body.append(f'<div class="equation">{tex2mathml(node.astext(), as_block=True)}</div>')
    _skip()


def _skip():
    from docutils import nodes

    raise nodes.SkipNode


def setup(app):
    """Registers the writer of equations under the name `mathml`."""
    app.add_html_math_renderer(
        "mathml", inline_renderers=(_inline, None), block_renderers=(_block, None)
    )
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
