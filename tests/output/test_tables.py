"""Tables: the columns in order, numbers without loss."""

import csv
import io

import numpy as np

from accelsurf.evolution.loop import StepRecord
from accelsurf.output import tables
from accelsurf.settings.trace_columns import TRACE_COLUMNS
from tests.support.records import step_record


def test_trace_has_the_columns_of_a_record_in_order_and_loses_no_digit():
    assert (*TRACE_COLUMNS, "extra") == StepRecord._fields
    last = step_record(1, dt=np.float64(1e-17), band_cells=np.int64(7))
    rows = [step_record(0, potential=1 / 3, restarted=True), last]
    text = tables.trace_csv(rows)
    read = list(csv.DictReader(io.StringIO(text)))
    assert tuple(read[0]) == tuple(TRACE_COLUMNS)
    assert float(read[0]["potential"]) == 1 / 3 and read[0]["restarted"] == "1"
    assert (
        float(read[1]["dt"]) == 1e-17
        and read[1]["band_cells"] == "7"
        and read[1]["restarted"] == "0"
    )
    assert text.endswith("\n") and "\r" not in text
