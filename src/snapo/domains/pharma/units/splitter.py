"""Splitter: divides a stream."""

from dataclasses import dataclass
from typing import Any, ClassVar

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import jnp

from ..flowsheet.stream import LedgerFinish, Stream, ledger
from ..given import use
from ..read.numbers import SHARE, several
from ..read.reader import TextKey
from .operation import Inlet, Instant

EXTENSIVE = (
    "species", "solid", "seed", "solvent", "antisolvent", "volume", "solids", "moments", "numbers",
    "inner_numbers",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Splitter(Instant):
    """Divides a stream into one for each of `ports`, by `share`.

    `share`: index [n - 1], each 0 to 1, of all outlets but the last, which takes the rest.
    """

    ports: tuple[str, ...]
    share: CaseInput

    type = "splitter"
    more_keys: ClassVar = {
        "outlets": (
            list[TextKey],
            doc(
                "outlets among which the stream is divided",
                allowed='two names or more, such as ["left", "right"]',
                min_length=2,
            ),
        ),
        "share": (
            Any,
            doc(
                "share of the stream in every outlet except the last",
                allowed="shares of all outlets except the last, from 0 to 1",
            ),
        ),
    }
    variant = ""
    title = "splitter"
    reacts = False
    symbols = ()
    assumptions = ()

    @classmethod
    def read(cls, read, species):
        ports, table, section = read.ports("outlets"), read.table, read.section
        raw = table.share if isinstance(table.share, list) else [table.share]
        name = f"{read.name}.share"
        if len(raw) != len(ports) - 1:
            message = f"it must be {len(ports) - 1} shares, one for each outlet except the last"
            raise section.error("share", table.share, message)
        text = "share of the stream"
        share = several(section, name, "share", raw, "1", ports[:-1], SHARE, text)
        if share.values.sum() > 1:
            raise section.error("share", table.share, "the shares add up to more than 1")
        return cls(read.name, ports, share)

    @property
    def inlets(self):
        return (Inlet("feed", "allowed"),)

    @property
    def outlets(self):
        return self.ports

    def sizes(self, inlets):
        return inlets * len(self.ports)

    def lasts(self, inlets):
        return inlets * len(self.ports)

    def measures(self, species):
        return {}

    def equations(self):
        return ["every amount is divided in the same shares"]

    def deliver(self, network, inlets, inputs):
        return LedgerFinish(self.split(inlets[0], inputs), {}, ledger(len(network.species)))

    def split(self, stream: Stream, inputs: dict[str, Any]) -> tuple[Stream, ...]:
        """The stream divided by the shares; the last outlet takes the rest."""
        shares = use(inputs, self.share)
        shares = jnp.append(shares, 1 - jnp.sum(shares))
        return tuple(
            stream.replace(**{name: getattr(stream, name) * share for name in EXTENSIVE})
            for share in shares
        )
