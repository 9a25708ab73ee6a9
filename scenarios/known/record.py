"""Records of a priori knowledge, their one-line form, and the merging of several scenarios' records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

Standing = Literal["exactly", "not", "absent", "partly"]


@dataclass(frozen=True, slots=True)
class Item:
    """One part of the truth and its a priori knowledge on board.

    Parameters
    ----------
    name
        Name of the part.
    standing
        ``exactly``: identical with the truth. ``not``: different from it or unknown. ``absent``: the truth has no such
        effect, which favours the estimators. ``partly``: exact or absent in some scenarios only.
    detail
        By how much it differs, or why it is absent.
    """

    name: str
    standing: Standing
    detail: str = ""

    def words(self, short: bool) -> str:
        """Return name and detail; the short form keeps the detail of absent parts only."""
        named = f"no {self.name}" if self.standing == "absent" else self.name
        wanted = self.detail and (not short or self.standing == "absent")
        return f"{named} ({self.detail})" if wanted else named


@dataclass(frozen=True, slots=True)
class Known:
    """A priori knowledge on board.

    Parameters
    ----------
    items
        In the order of the line, each name once.
    remarks
        Sentences about further dependences of the estimators on the truth.
    aligned
        Names of reference poses that were determined by methods like those that are evaluated against them.
    """

    items: tuple[Item, ...]
    remarks: tuple[str, ...] = ()
    aligned: tuple[str, ...] = ()

    @property
    def exactly(self) -> tuple[str, ...]:
        """Names of what is known exactly."""
        return tuple(item.name for item in self.items if item.standing == "exactly")

    @property
    def not_exactly(self) -> tuple[str, ...]:
        """Names of what is not."""
        return tuple(item.name for item in self.items if item.standing == "not")

    def line(self, short: bool = False) -> str:
        """Return the record as one line; the short one is without details and remarks."""
        said = {
            standing: [item.words(short) for item in self.items if item.standing == standing]
            for standing in ("exactly", "absent", "partly", "not")
        }
        sentences = ["; ".join([f"Known exactly: {', '.join(said['exactly']) or 'nothing'}", *said["absent"]])]
        if said["partly"]:
            sentences.append(f"In some scenarios alone: {', '.join(said['partly'])}")
        sentences.append(f"Not known exactly: {', '.join(said['not']) or 'nothing'}")
        sentences += [*([] if short else self.remarks), *map(correlated, self.aligned)]
        return " ".join(f"{sentence}." for sentence in sentences)


def correlated(reference: str) -> str:
    """Return the remark on a reference pose that was determined by aligning renderings."""
    return (
        f"Errors against {reference} are correlated with those of methods that align renderings of the shape, for"
        f" {reference} was found by doing so"
    )


def item(name: str, exact: bool, detail: str = "") -> Item:
    """Make an item that is exact or not; the detail applies to the latter."""
    return Item(name, "exactly") if exact else Item(name, "not", detail)


def spin_item(pole_sigma_deg: float, rate_sigma: float) -> Item:
    """Make the item of a spin with standard deviations of its pole and its relative rate."""
    pole = f"pole {pole_sigma_deg:g} deg" if pole_sigma_deg else ""
    rate = f"rate {100.0 * rate_sigma:g} %" if rate_sigma else ""
    return item("spin", not (pole or rate), listed([pole, rate]))


def merged(several: Sequence[Known]) -> Known:
    """Merge the knowledge of several scenarios; parts that are exact in some of them only become ``partly``."""
    names = dict.fromkeys(one.name for known in several for one in known.items)
    own = [[one for known in several for one in known.items if one.name == name] for name in names]
    items = [_joined(found, len(several)) for found in own]
    remarks = dict.fromkeys(line for known in several for line in known.remarks)
    return Known(
        tuple(items), tuple(remarks), tuple(dict.fromkeys(name for known in several for name in known.aligned))
    )


def _joined(own: Sequence[Item], scenarios: int) -> Item:
    """Merge the items of one name; a detail is kept if all have the same.

    A part that only some scenarios have becomes ``not`` if it is unknown there, and ``partly`` if it is exact there. It
    stays ``exactly`` if it is absent from the other scenarios.
    """
    standings, details = {one.standing for one in own}, {one.detail for one in own}
    if standings == {"exactly", "absent"} and len(own) == scenarios:
        return Item(own[0].name, "exactly")
    if standings == {"not"} or (len(standings) == 1 and len(own) == scenarios):
        return Item(own[0].name, own[0].standing, own[0].detail if len(details) == 1 else "")
    absent = standings == {"absent", "not"}
    return Item(f"no {own[0].name}" if absent else own[0].name, "partly")


def listed(parts: Iterable[str]) -> str:
    """Join the non-empty parts of a detail."""
    return ", ".join(part for part in parts if part)
