"""Choose the cases of a test that run by default; ``scripts/test --all`` runs all of them."""

from collections.abc import Hashable, Mapping, Sequence


def sampled(cases: Sequence[Mapping[str, Hashable]], count: int | None = None) -> set[int]:
    """Return the numbers of the cases that run by default.

    Parameters
    ----------
    cases
        For each case the value of each parameter, or what identifies it.
    count
        So many cases, from the first to the last at equal distances. By default as few as have each value of each
        parameter at least once.

    Examples
    --------
    >>> sorted(sampled([{"a": a, "b": b} for a in range(2) for b in range(3)]))
    [0, 2, 4]
    >>> sorted(sampled([{"a": a} for a in range(9)], 3))
    [0, 4, 8]
    """
    if count is not None:
        count, last = min(count, len(cases)), len(cases) - 1
        return {last * number // max(count - 1, 1) for number in range(count)}
    needed: set[int] = set()
    missing = {pair for case in cases for pair in case.items()}
    while missing:
        gains = [len(missing & case.items()) for case in cases]
        best = gains.index(max(gains))
        needed.add(best)
        missing -= cases[best].items()
    return needed
