"""What a cell prints, in one piece: chunks are joined as they came.

MyST-NB's own merge (1.4) ends every chunk with a new line, so that the output of a command breaks
in the middle of words.
"""

from typing import Any

from myst_nb.core import render


def joined(outputs: list[Any]) -> list[Any]:
    """Outputs with one stream of each name, standard output first."""
    found: dict[str, Any] = {}
    others = []
    for output in outputs:
        if output["output_type"] != "stream":
            others.append(output)
        elif output["name"] in found:
            found[output["name"]]["text"] += output["text"]
        else:
            found[output["name"]] = output
    streams = [found[name] for name in ("stdout", "stderr") if name in found]
    return [*streams, *others]


def setup(app):
    assert hasattr(render, "coalesce_streams"), "MyST-NB merges streams elsewhere now"
    render.coalesce_streams = joined
    return {"parallel_read_safe": True}
