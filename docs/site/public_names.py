"""The directive `public-names`: the reference of every name in `snapo/__init__.pyi`.

Docstrings are written to be read in an editor: a backtick is code, and a bar or a star is itself.
"""

import re
from collections import defaultdict
from pathlib import Path
from types import ModuleType

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective
from sphinx.util.parsing import nested_parse_to_nodes

import snapo
from snapo import _homes

HEADS = {
    "problem": "A problem: simulator, inputs, decisions, objective",
    "engine": "Engines",
    "checker": "The check of a simulator",
    "solver": "Solving, and how far to trust the answer",
    "case": "Tables of cases",
    "gym": "Environments that cannot be differentiated",
}
PLAIN = re.compile(r"(``[^`]*``|`[^`]*`|\*\*[^*\n]+\*\*)")


class PublicNames(SphinxDirective):
    """A section for each room of the package, with all of its public names."""

    def run(self) -> list[nodes.Node]:
        rooms = defaultdict(list)
        for name, home in _homes().items():
            thing = getattr(snapo, name)
            if isinstance(thing, ModuleType):  # `snapo.noise`: in the room of what it offers
                home = getattr(thing, thing.__all__[0]).__module__
            rooms[home.split(".")[1]].append((name, home))
        found = []
        for room, names in rooms.items():
            section = nodes.section(ids=[nodes.make_id(f"room-{room}")])
            section += nodes.title("", HEADS.get(room, room))
            section += self._written(names)
            found.append(section)
        return found

    def _written(self, names) -> list[nodes.Node]:
        lines = []
        things = {name: getattr(snapo, name) for name, _ in names}
        for name, module in list(things.items()):
            if isinstance(module, ModuleType):
                del things[name]
                inside = {each: getattr(module, each) for each in module.__all__}
                # A name that stands at the top too, as `Noise` does, is described there.
                things |= {f"{name}.{n}": x for n, x in inside.items() if n not in things}
        for name, thing in things.items():
            kind = "class" if isinstance(thing, type) else "function" if callable(thing) else "data"
            lines += [f".. auto{kind}:: snapo.{name}"]
            lines += ["   :members:", ""] if kind == "class" else [""]
        text = ["```{eval-rst}", *lines, "```"]
        return nested_parse_to_nodes(
            self.state, StringList(text, source=str(Path(snapo.__file__).with_suffix(".pyi")))
        )


def _as_written(app, what, name, thing, options, lines):
    """A docstring in which only code and bold words are markup."""
    code, written = False, list(lines)
    lines.clear()
    for i, line in enumerate(written):
        inside = line.startswith("    ")
        if inside and not code and (not i or not written[i - 1].strip()):
            lines.extend(["::", ""])  # an indented block is code
        code = line.lstrip().startswith(">>>") or (code and bool(line.strip())) or inside
        if not code:
            parts = PLAIN.split(line)
            parts[::2] = [re.sub(r"([|*]|(?<=\w)_(?=\W|$))", r"\\\1", part) for part in parts[::2]]
            # Code is followed by a blank or a mark; of "`Input`s" the s comes after a null one.
            parts[1::2] = [
                code_ + "\\ " * after[:1].isalnum()
                for code_, after in zip(parts[1::2], parts[2::2])
            ]
            line = "".join(parts)
        lines.append(line)


def _plain_defaults(app, what, name, thing, options, signature, returns):
    """Defaults that are functions, without their addresses."""
    return (re.sub(r"<(\w+ )?(\w+)[^>]*at 0x\w+>", r"\2", signature), "") if signature else None


def setup(app):
    """Registers the directive, and what is done to docstrings."""
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-docstring", _as_written)
    app.connect("autodoc-process-signature", _plain_defaults)
    return {"parallel_read_safe": True}
