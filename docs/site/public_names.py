"""The directive `public-names`: the reference of every name in `snapo/__init__.pyi`.

Docstrings are written to be read in an editor: a backtick is code, and a bar or a star is itself.
"""

import re
from pathlib import Path
from types import ModuleType

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective
from sphinx.util.parsing import nested_parse_to_nodes

import snapo

# {heading: its names, the most needed ones first}; the rest of a module follows where it belongs.
CONCEPTS = {
    "Solve a problem": "solve Solution Training Evaluation check Findings Finding",
    "Describe a problem: simulator and inputs": "Simulator Schedule Input Frozen Problem Interface "
    "Smooth Exact EXACT angle_features wrap_angle",
    "Decisions": "Box Simplex Integers Choice Stop Product Actions",
    "Objectives and constraints": "Mean CVaR MeanVariance Entropic CRRA Target Probability "
    "ExpectedUtility Objective AtMost AtLeast Limit LimitFound",
    "Noise and scenarios": "noise Noise Process Schwartz SchwartzInputs Pseudo Sobol Supplied "
    "Sources Scenarios Counter Stored",
    "Policies": "MLP GRU LastObservations Linear BaseStock Threshold Constant Residual Stages "
    "Policy Network Memory imitate Imitation",
    "Values, derivatives and bounds": "evaluate Value Estimate Sampled simulate Simulation "
    "sensitivities Sensitivities SensitivityRow Interval Reported bound Bound Between second_order "
    "value_and_gradient Gradient bump_check Bump feasibility Feasibility Verdict",
    "Several trainings": "solve_seeds Seeds Chain Family",
    "Save, export and show": "load_policy to_onnx decision_table TableDecisions PolicyFileError "
    "write_table Figures log Progress Record",
    "Environments that cannot be differentiated": "learn Learned LearningRound Compared",
    "Advanced: engines and relaxations": "Engine Native Xla Engines BoundEngine Rollout Adjoint "
    "Window Clip Growth Relaxation nested_mean",
}
PLAIN = re.compile(r"(``[^`]*``|`[^`]*`|\*\*[^*\n]+\*\*)")


class PublicNames(SphinxDirective):
    """A section for each concept, with all of its public names."""

    def run(self) -> list[nodes.Node]:
        concepts = {head: names.split() for head, names in CONCEPTS.items()}
        listed = {name for names in concepts.values() for name in names}
        if unknown := listed - {*snapo.__all__}:
            raise self.error(f"snapo has no {sorted(unknown)}: see CONCEPTS in {__file__}")
        if more := sorted({*snapo.__all__} - listed - {"__version__"}):
            concepts["Further names"] = more
        found = []
        for head, names in concepts.items():
            section = nodes.section(ids=[nodes.make_id(head)])
            section += nodes.title("", head)
            section += self._written(names)
            found.append(section)
        return found

    def _written(self, names) -> list[nodes.Node]:
        lines = []
        things = {name: getattr(snapo, name) for name in names}
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
    """Defaults that are functions without their addresses, and types without their modules."""
    return (_short(signature), _short(returns or "")) if signature else None


def _short(signature: str) -> str:
    text = re.sub(r"<(\w+ )?(\w+)[^>]*at 0x\w+>", r"\2", signature)
    return re.sub(r"\b(?:~?[a-z_]\w*\.)+(?=[A-Z])", "", text).replace("Any | None", "Any")


def setup(app):
    """Registers the directive, and what is done to docstrings."""
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-docstring", _as_written)
    app.connect("autodoc-process-signature", _plain_defaults)
    return {"parallel_read_safe": True}
