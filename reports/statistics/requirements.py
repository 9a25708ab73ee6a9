"""Tests of whether a requirement is met: a share of all trials is within a limit; trials without an estimate are not.

``position_error_m < 30 in 99.73 % at 90 %``: at least 99.73 % of the trials that could be drawn lie below 30 m, to be
shown with a confidence of 90 %. With a number of trials fixed beforehand the test is exact: the requirement is met if
so few misses have a probability of at most 10 % where exactly 99.73 % of the trials are within the limit (J. M. Hanson
and B. B. Beard, Applying Monte Carlo Simulation to Launch Vehicle Design and Requirements Analysis,
NASA/TP-2010-216447). A run that is looked at again and again needs a test that holds at every look, see `Evidence`.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtr, betainc, betaincc, betaln

from boresight.reports.schema.tables import AFTER_REVOLUTIONS, columns_of, kind_schema, measure_of
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError

PASS, FAIL, UNDECIDED = "pass", "fail", "undecided"
YES_OR_NO, SECONDS = ("solved", "success"), "seconds"
_MORE = ("nees", "mean_position_nees", "position_sigma_m", "attitude_sigma_deg")
"""Numbers of rows that are no errors and can be required."""

_NUMBER = r"[+-]?(?:\d+(?:\.\d+)?|\.\d+)(?:e[+-]?\d+)?"
_WRITTEN = re.compile(
    rf"\s*(?P<measure>\w+)(?:\s*<\s*(?P<limit>{_NUMBER}))?\s+in\s+(?P<share>{_NUMBER})\s*%"
    rf"\s+at\s+(?P<confidence>{_NUMBER})\s*%\s*",
    re.IGNORECASE,
)
_MOST_TRIALS = 10_000_000
_LEAST_SHARE = 1e-7
"""Of trials within the limit, and of those beyond: to show a smaller one takes more than `_MOST_TRIALS`."""
_MOST_LOG = 700.0  # exp of more overflows


@dataclass(frozen=True, slots=True)
class Requirement:
    """A measure of a trial lies below ``limit`` in a ``share`` of all trials, to be shown with a ``confidence``.

    Without a limit the measure is a yes or no: ``solved`` or ``success``. ``written`` is what the user wrote.
    """

    written: str
    measure: str
    limit: float | None
    share: float
    confidence: float

    @property
    def risk(self) -> float:
        """Probability that is allowed of passing what is not met, and of failing what is."""
        return 1.0 - self.confidence

    def missed(self, values: FloatArray) -> BoolArray:
        """(n,) whether trials miss it, by their measure (n,), infinite for a failure; of a yes or no 0 for yes."""
        return np.asarray(~(values < (0.5 if self.limit is None else self.limit)))

    def in_words(self) -> str:
        """Write it as a clause, its measure by its label and with its unit."""
        known = measure_of(self.measure)
        what = known.label if self.limit is None else f"{known.label} below {self.limit:g} {known.unit or ''}".rstrip()
        return f"{what} in at least {100 * self.share:g} % of all trials, with {100 * self.confidence:g} % confidence"


def parse_requirement(text: str) -> Requirement:
    """Read ``MEASURE < LIMIT in SHARE % at CONFIDENCE %``; raise BoresightError if it is written otherwise."""
    found = _WRITTEN.fullmatch(text)
    if found is None:
        raise BoresightError(
            f"{text!r} is no requirement: write it as 'position_error_m < 30 in 99.73 % at 90 %', or 'success in 95 %"
            " at 90 %'"
        )
    share, confidence = float(found["share"]) / 100.0, float(found["confidence"]) / 100.0
    if not _LEAST_SHARE <= share <= 1.0 - _LEAST_SHARE:
        least, most = 100.0 * _LEAST_SHARE, 100.0 * (1.0 - _LEAST_SHARE)
        raise BoresightError(
            f"{text!r}: {_MOST_TRIALS:,} trials do not show {100.0 * share:g} %: give a share from {least:g} to"
            f" {most:.8g} %"
        )
    if not 0.5 <= confidence < 1.0:
        raise BoresightError(f"{text!r}: a confidence is from 50 to below 100 %, not {100.0 * confidence:g} %")
    limit = None if found["limit"] is None else float(found["limit"])
    if limit is not None and not np.isfinite(limit):
        raise BoresightError(f"{text!r}: the limit is beyond {np.finfo(float).max:.1e}: give a smaller one")
    return Requirement(" ".join(text.split()), found["measure"].lower(), limit, share, confidence)


def read_requirement(text: str, experiment: str) -> Requirement:
    """Read a requirement on a kind of trial.

    Raise BoresightError if it cannot be read, or names no measure of that kind.
    """
    asked = parse_requirement(text)
    errors = [column.name for column in columns_of("rows", experiment) if column.error or column.name in _MORE]
    known = (*kind_schema(experiment).metrics, *errors, SECONDS)
    # Rows have columns of the first revolutions; those of any other follow from the frames.
    after = AFTER_REVOLUTIONS.fullmatch(asked.measure) and any(map(AFTER_REVOLUTIONS.fullmatch, errors))
    if asked.limit is None and asked.measure not in YES_OR_NO:
        yes_or_no = " and ".join(YES_OR_NO)
        raise BoresightError(f"{text!r}: {asked.measure} needs a limit; without one there are {yes_or_no}")
    if asked.limit is not None and asked.limit <= 0.0:
        raise BoresightError(f"{text!r}: a measure counts by its size, which is never below {asked.limit:g}")
    if asked.limit is not None and asked.measure not in known and not after:
        named = ", ".join(dict.fromkeys(known))
        raise BoresightError(f"{text!r}: {asked.measure} is no measure of {experiment}: choose one of {named}")
    return asked


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict of ``n`` trials, of which ``missed`` are not within the limit of a requirement.

    ``reached`` is the limit that would just pass, so that the margin is from there to the requirement's limit. It is
    infinite if none would: too few trials, or too many failures; None of a yes or no. ``risk`` is the consumer's: the
    probability of trials that speak as much for the requirement where it is just not met. ``further`` trials without a
    miss would pass it: 0 if it has passed, None if it has failed, or more than ten million would be needed. About so
    many trials more, ``at_this_rate``, would decide it if the rate of misses stays: 0 where it is decided, None without
    a trial, or where more than ten million would be needed.
    """

    verdict: str
    n: int
    missed: int
    reached: float | None
    risk: float
    further: int | None
    at_this_rate: int | None


def judge(
    requirement: Requirement,
    values: FloatArray,
    *,
    best: FloatArray | None = None,
    looked: bool = False,
    turns: int = 1,
) -> Verdict:
    """Judge trials by their measure (n,) in their order, infinite for a failure; of a yes or no 0 for yes and 1 for no.

    The number of trials was fixed beforehand, unless the run was ``looked`` at before and could have ended there. Where
    trials depend on each other, give the worst of each independent unit, and the ``best`` (n,): a unit passes by its
    worst trial and fails by its best. ``turns`` is the number of data bases that trials have in turn: their chances of
    a miss differ, and a look is valid after each had as many trials.
    """
    missed = requirement.missed(values)
    verdict, risk = _tested(requirement, missed, looked, turns)
    if (
        verdict == FAIL
        and best is not None
        and _tested(requirement, requirement.missed(best), looked, turns)[0] != FAIL
    ):
        verdict = UNDECIDED
    reached = None if requirement.limit is None else _reached(requirement, values, looked, turns)
    n, m = len(values), int(missed.sum())
    if verdict != UNDECIDED:
        return Verdict(verdict, n, m, reached, risk, 0 if verdict == PASS else None, 0)
    least, step = m if best is None else int(requirement.missed(best).sum()), turns if looked else 1

    def sides(misses: float, total: int) -> tuple[bool, bool]:
        return _sides(requirement, misses, total, looked=looked)

    def decided(total: int) -> bool:
        # Rates of misses and not numbers of them, so that more trials never undo a verdict.
        return sides(m / n * total, total)[0] or sides(least / n * total, total)[1]

    further = _first(n, step, lambda total: sides(m, total)[0])
    at_this_rate = _first(n, step, decided) if n else None
    return Verdict(verdict, n, m, reached, risk, further, at_this_rate)


def _tested(requirement: Requirement, missed: BoolArray, looked: bool, turns: int) -> tuple[str, float]:
    """Return the verdict and the consumer's risk."""
    if looked:
        found = Evidence.of(missed, requirement.share, turns)
        return found.verdict(requirement.risk)[0], min(1.0, 1.0 / float(found.passes.max(initial=1.0)))
    n, m = len(missed), int(missed.sum())
    few, many = _chances(m, n, 1.0 - requirement.share)
    return PASS if few <= requirement.risk else FAIL if many <= requirement.risk else UNDECIDED, few


def upper_limit(values: FloatArray, share: float, confidence: float) -> float:
    """Return the value below which a share of all trials lies, with a confidence: the k-th least of ``values`` (n,).

    k is the least for which a binomial number with n and the share is below k with that confidence; infinite if n is
    too small. It holds for any distribution (S. S. Wilks, Determination of sample sizes for setting tolerance limits,
    Annals of Mathematical Statistics 12, 1941).
    """
    n = len(values)
    k = int(np.searchsorted(bdtr(np.arange(n, dtype=np.float64), n, share), confidence)) + 1
    return float(np.sort(values)[k - 1]) if k <= n else np.inf


def _reached(requirement: Requirement, values: FloatArray, looked: bool, turns: int) -> float:
    if not looked:
        return upper_limit(values, requirement.share, requirement.confidence)
    # The evidence rises with the limit, so the least that passes is found by halving.
    ordered = np.unique(values[np.isfinite(values)])

    def passes(limit: float) -> bool:
        return _tested(requirement, values > limit, looked, turns)[0] == PASS

    number = bisect_left(range(len(ordered)), 1, key=lambda i: int(passes(float(ordered[i]))))
    return float(ordered[number]) if number < len(ordered) else np.inf


def _sides(requirement: Requirement, m: float, n: int, *, looked: bool) -> tuple[bool, bool]:
    """Tell whether m misses in n trials pass it, and whether they fail it; of a run that is looked at, at one look.

    Between whole numbers of misses the binomial distribution is continued by the incomplete beta function.
    """
    allowed = 1.0 - requirement.share
    if looked:
        passes, fails = (float(one) >= -np.log(requirement.risk) for one in _log_evidence(m, n, allowed))
        return passes, fails
    few, many = _chances(m, n, allowed)
    return few <= requirement.risk, many <= requirement.risk


def _chances(m: float, n: int, rate: float) -> tuple[float, float]:
    """Return the probabilities of at most and of at least m misses in n trials."""
    few = float(betaincc(m + 1.0, n - m, rate)) if m < n else 1.0
    return few, float(betainc(m, n - m + 1.0, rate)) if m > 0.0 else 1.0


def _first(n: int, step: int, decided: Callable[[int], bool]) -> int | None:
    """Return after how many further trials it is decided, n + these a multiple of ``step``; None of too many."""
    totals = range(step * (n // step + 1), _MOST_TRIALS, step)
    place = bisect_left(totals, 1, key=lambda total: int(decided(total)))
    return totals[place] - n if place < len(totals) else None


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Evidence after each trial (n,) that a requirement is met (``passes``) and that it is not (``fails``).

    Each is the likelihood of the trials so far, averaged over the rates of misses on one side of the allowed one, over
    that at the allowed rate. Where the requirement is not met, ``passes`` is a supermartingale from 1 on, so that it
    ever reaches 1 / a with a probability of at most a, however often one looks (H. Robbins, Statistical methods related
    to the law of the iterated logarithm, Annals of Mathematical Statistics 41, 1970); and ``fails`` where it is met.
    The average is that of Jeffreys' prior, Beta(1/2, 1/2), on each side.
    """

    passes: FloatArray
    fails: FloatArray

    @classmethod
    def of(cls, missed: BoolArray, share: float, turns: int = 1) -> Evidence:
        """Weigh trials (n,) in their order by whether they missed.

        It is a supermartingale where each trial has the same chance of a miss. Where trials have so many chances in
        turn, it is one after every so many ``turns``: a product of factors is at most their mean to its power.
        """
        logs = _log_evidence(np.cumsum(missed), np.arange(1, len(missed) + 1), 1.0 - share)
        passes, fails = (np.exp(np.minimum(one[turns - 1 :: turns], _MOST_LOG)) for one in logs)
        return cls(passes, fails)

    def verdict(self, risk: float) -> tuple[str, int]:
        """Return the verdict of the first of the two to reach 1 / risk, and after how many looks that was."""
        first = {
            name: int(np.argmax(path >= 1.0 / risk))
            for name, path in ((PASS, self.passes), (FAIL, self.fails))
            if (path >= 1.0 / risk).any()
        }
        if not first:
            return UNDECIDED, len(self.passes)
        verdict = min(first, key=lambda name: first[name])
        return verdict, first[verdict] + 1


def _log_evidence(misses: IndexArray | float, n: IndexArray | int, allowed: float) -> tuple[FloatArray, FloatArray]:
    """Logarithms of `Evidence` for numbers of misses among numbers n of trials, and an allowed rate of misses."""
    a, b = 0.5 + misses, 0.5 + n - misses
    boundary = misses * np.log(allowed) + (n - misses) * np.log1p(-allowed)
    whole = betaln(a, b) - betaln(0.5, 0.5) - boundary
    with np.errstate(divide="ignore"):
        below = np.log(betainc(a, b, allowed)) - np.log(betainc(0.5, 0.5, allowed))
        above = np.log(betaincc(a, b, allowed)) - np.log(betaincc(0.5, 0.5, allowed))
    return whole + below, whole + above
