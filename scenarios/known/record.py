"""One line of what on board is identical with the truth and what is not, and how lines of several scenarios join."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

Standing = Literal["exactly", "not", "absent", "partly"]


@dataclass(frozen=True, slots=True)
class Item:
    """A thing that the truth has and the spacecraft may know.

    Parameters
    ----------
    name
        What it is.
    standing
        ``exactly``: on board it is the very thing of the truth. ``not``: it differs, or nothing on board tells it.
        ``absent``: the truth has none of it, which the spacecraft profits from. ``partly``: so in some scenarios alone.
    detail
        By how much it differs, or why it is absent.
    """

    name: str
    standing: Standing
    detail: str = ""

    def words(self, short: bool) -> str:
        """Name it, with its detail unless that is to be left out; why a thing is absent is always said."""
        named = f"no {self.name}" if self.standing == "absent" else self.name
        wanted = self.detail and (not short or self.standing == "absent")
        return f"{named} ({self.detail})" if wanted else named


@dataclass(frozen=True, slots=True)
class Known:
    """What a spacecraft is taken to know.

    Parameters
    ----------
    items
        In the order of the line, each name once.
    remarks
        Sentences on what else ties the estimators to the truth.
    aligned
        Names of reference poses that were found by the means of the methods that are held against them.
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
        """Say it in one line; the short one is without details and remarks."""
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
    """Say what a reference pose is that was found by aligning renderings."""
    return (
        f"Errors against {reference} are correlated with those of methods that align renderings of the shape, for"
        f" {reference} was found by doing so"
    )


def item(name: str, exact: bool, detail: str = "") -> Item:
    """Make an item that is known exactly or not; the detail belongs to what is not."""
    return Item(name, "exactly") if exact else Item(name, "not", detail)


def spin_item(pole_sigma_deg: float, rate_sigma: float) -> Item:
    """Make the item of a spin whose pole and rate, relative, are known so well."""
    pole = f"pole {pole_sigma_deg:g} deg" if pole_sigma_deg else ""
    rate = f"rate {100.0 * rate_sigma:g} %" if rate_sigma else ""
    return item("spin", not (pole or rate), listed([pole, rate]))


def merged(several: Sequence[Known]) -> Known:
    """Join what is known in several scenarios: what is so in some alone is said to be."""
    names = dict.fromkeys(one.name for known in several for one in known.items)
    own = [[one for known in several for one in known.items if one.name == name] for name in names]
    items = [_joined(found, len(several)) for found in own]
    remarks = dict.fromkeys(line for known in several for line in known.remarks)
    return Known(
        tuple(items), tuple(remarks), tuple(dict.fromkeys(name for known in several for name in known.aligned))
    )


def _joined(own: Sequence[Item], scenarios: int) -> Item:
    """Join the items of one name; a detail stays where all have the same.

    What only some scenarios have, and is not known there, is not known; what is known there is so in some.
    """
    standings, details = {one.standing for one in own}, {one.detail for one in own}
    if standings == {"not"} or (len(standings) == 1 and len(own) == scenarios):
        return Item(own[0].name, own[0].standing, own[0].detail if len(details) == 1 else "")
    absent = standings == {"absent", "not"}
    return Item(f"no {own[0].name}" if absent else own[0].name, "partly")


def listed(parts: Iterable[str]) -> str:
    """Join the parts of a detail that there are."""
    return ", ".join(part for part in parts if part)
