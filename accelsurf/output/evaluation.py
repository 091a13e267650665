"""Tables and document of `accelsurf evaluate`: a row of numbers for each case and label."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from accelsurf.io.cells import table_text
from accelsurf.measure.label_metrics import LabelAgreement, over_cases
from accelsurf.settings.labels import LabelTable

#: Columns of the table that is printed: heading, and the number that it shows.
_PRINTED = (
    ("dice", "dice"),
    ("iou", "iou"),
    ("pred ml", "volume_pred_ml"),
    ("ref ml", "volume_ref_ml"),
    ("diff ml", "volume_difference_ml"),
    ("max mm", "hausdorff_mm"),
    ("95% mm", "hd95_mm"),
    ("mean mm", "mean_surface_distance_mm"),
)
_DICE_AT = "surface_dice_"


@dataclass(frozen=True)
class CaseResult:
    """Outcome of one case.

    Attributes
    ----------
    case, pred, ref : str
        Its name, and the files.
    agreements : tuple of LabelAgreement
        One for each label; empty when the case has failed.
    failure : str
        Why it has failed; empty if it has not.
    """

    case: str
    pred: str
    ref: str
    agreements: tuple[LabelAgreement, ...] = ()
    failure: str = ""


def label_entry(agreement: LabelAgreement, names: LabelTable) -> dict[str, Any]:
    """One label of one case for JSON."""
    return {"label": agreement.label, "name": label_name(agreement, names), **agreement.values()}


def label_name(agreement: LabelAgreement, names: LabelTable) -> str:
    """Name of a label; empty where nobody gave one."""
    return names.entries[agreement.label].name if agreement.label in names.entries else ""


def summaries(results: Sequence[CaseResult], names: LabelTable) -> list[dict[str, Any]]:
    """Mean, median and count over cases, for each label."""
    by_label: dict[int | None, list[LabelAgreement]] = {}
    for agreement in (agreement for result in results for agreement in result.agreements):
        by_label.setdefault(agreement.label, []).append(agreement)
    return [
        {
            "label": label,
            "name": label_name(some[0], names),
            **over_cases([agreement.values() for agreement in some]),
        }
        for label, some in sorted(by_label.items(), key=lambda item: item[0] or 0)
    ]


def notes(agreement: LabelAgreement) -> list[str]:
    """Return remarks that the numbers of a label do not make by themselves."""
    if agreement.label is None:
        sides = (agreement.in_pred, "PRED"), (agreement.in_ref, "REF")
        counts = [f"{len(ids)} of {side}" for ids, side in sides if len(ids) > 1]
        said = (
            f"several labels count as one object: {', '.join(counts)}; --labels all compares each"
        )
        return [said] if counts else []
    if agreement.in_pred and agreement.in_ref:
        return []
    if not (agreement.in_pred or agreement.in_ref):
        return [f"label {agreement.label}: in neither map; nothing is defined"]
    where = "PRED" if agreement.in_pred else "REF"
    return [f"label {agreement.label}: only in {where}; overlaps are 0, distances not defined"]


def document(results: Sequence[CaseResult], names: LabelTable) -> dict[str, Any]:
    """Many cases for JSON."""
    cases: list[dict[str, Any]] = []
    for result in results:
        said = [text for agreement in result.agreements for text in notes(agreement)]
        cases.append(
            {
                "case": result.case,
                "pred": result.pred,
                "ref": result.ref,
                "status": "failed" if result.failure else "ok",
                "failure": result.failure or None,
                "labels": [label_entry(agreement, names) for agreement in result.agreements],
                "notes": said,
            }
        )
    failed = sum(bool(result.failure) for result in results)
    counts = {"cases": len(results), "ok": len(results) - failed, "failed": failed}
    return {"counts": counts, "summary": summaries(results, names), "cases": cases}


def table_csv(results: Sequence[CaseResult], names: LabelTable) -> str:
    """CSV text: a row for each case and label; with several cases also their mean, median and count for each label.

    The column ``row`` says which: case, mean, median or count. What is not defined is empty.
    """
    numbers = dict.fromkeys(
        name for result in results for found in result.agreements for name in found.values()
    )
    columns = ["row", "case", "pred", "ref", "status", "failure", "label", "name", *numbers]
    rows: list[dict[str, Any]] = []
    for result in results:
        of_case = {"row": "case", "case": result.case, "pred": result.pred, "ref": result.ref}
        if result.failure:
            rows.append({**of_case, "status": "failed", "failure": result.failure})
        for agreement in result.agreements:
            rows.append({**of_case, "status": "ok", **label_entry(agreement, names)})
    if len(results) > 1:
        for summary in summaries(results, names):
            for row in ("mean", "median", "count"):
                rows.append(
                    {"row": row, "label": summary["label"], "name": summary["name"], **summary[row]}
                )
    return table_text(columns, ([row.get(column) for column in columns] for row in rows))


def printed_rows(
    entries: Sequence[tuple[tuple[str, ...], dict[str, float | None]]], first: tuple[str, ...]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of a table on the screen.

    Parameters
    ----------
    entries : sequence of (tuple of str, dict)
        The first cells of each row, and its numbers.
    first : tuple of str
        Headings of the first cells.
    """
    dice_at = dict.fromkeys(
        name for _, values in entries for name in values if name.startswith(_DICE_AT)
    )
    shown = [*_PRINTED, *((f"sd {name.removeprefix(_DICE_AT)}", name) for name in dice_at)]
    rows = [(*cells, *(_text(values.get(name)) for _, name in shown)) for cells, values in entries]
    return (*first, *(heading for heading, _ in shown)), rows


def _text(value: float | None) -> str:
    return "-" if value is None else format(value, ".4g")
