"""Tables and document of `accelsurf evaluate`: a row of numbers for each case and label."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from accelsurf.io import table_text
from accelsurf.measure import LabelAgreement, over_cases
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
#: First columns of a table in CSV.
_FIRST = ("row", "case", "pred", "ref", "status", "failure", "label", "name")


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
    entries = []
    for label, some in sorted(by_label.items(), key=lambda item: item[0] or 0):
        numbers = over_cases([agreement.values() for agreement in some])
        entries.append({"label": label, "name": label_name(some[0], names), **numbers})
    return entries


def evaluation_notes(agreement: LabelAgreement) -> list[str]:
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


def evaluation_document(results: Sequence[CaseResult], names: LabelTable) -> dict[str, Any]:
    """Many cases for JSON."""
    cases: list[dict[str, Any]] = []
    for result in results:
        said = [text for agreement in result.agreements for text in evaluation_notes(agreement)]
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


def evaluation_rows(results: Sequence[CaseResult], names: LabelTable) -> list[dict[str, Any]]:
    """Rows of a table: one for each case and label; with several cases also their mean, median and count.

    The entry ``row`` says which: case, mean, median or count. An entry that is not defined is None, or is not there.
    """
    rows: list[dict[str, Any]] = []
    for result in results:
        of_case = {"row": "case", "case": result.case, "pred": result.pred, "ref": result.ref}
        if result.failure:
            rows.append({**of_case, "status": "failed", "failure": result.failure})
        for agreement in result.agreements:
            rows.append({**of_case, "status": "ok", **label_entry(agreement, names)})
    for summary in summaries(results, names) if len(results) > 1 else ():
        for row in ("mean", "median", "count"):
            rows.append(
                {"row": row, "label": summary["label"], "name": summary["name"], **summary[row]}
            )
    return rows


def evaluation_csv(rows: Sequence[dict[str, Any]]) -> str:
    """CSV text of `evaluation_rows`; an entry that is not defined is empty."""
    columns = list(dict.fromkeys([*_FIRST, *(name for row in rows for name in row)]))
    return table_text(columns, ([row.get(column) for column in columns] for row in rows))


def printed_rows(
    rows: Sequence[dict[str, Any]], many: bool
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of a table on the screen.

    Parameters
    ----------
    rows : sequence of dict
        From `evaluation_rows`; cases that have failed are left out.
    many : bool
        Whether cases have names.
    """
    rows = [row for row in rows if "label" in row]
    first = ["case"] * many + ["label"] + ["name"] * any(row["name"] for row in rows)
    dice_at = dict.fromkeys(name for row in rows for name in row if name.startswith(_DICE_AT))
    shown = [*_PRINTED, *((f"sd {name.removeprefix(_DICE_AT)}", name) for name in dice_at)]
    cells = []
    for row in rows:
        said = {
            "case": row.get("case", row["row"]),
            "label": "all" if row["label"] is None else str(row["label"]),
            "name": row["name"] or "-",
        }
        cells.append(
            (*(said[name] for name in first), *(_text(row.get(name)) for _, name in shown))
        )
    return (*first, *(heading for heading, _ in shown)), cells


def _text(value: float | None) -> str:
    return "-" if value is None else format(value, ".4g")
