"""Data bases beside each other, from hand-made records."""

from pathlib import Path

import pandas as pd

from boresight.reports.kinds.single_image import mesh_variants, sensitivity_grid
from boresight.reports.published import load_published
from boresight.reports.run.data import Manifest, RunData, StoredProduct
from boresight.reports.schema.records import Record


def records(label, landmarks, position, against=""):
    def record(stage, measure, statistic, value, reference=""):
        return Record("s", label, stage, reference, measure, "", statistic, value, value - 1, value + 1, 9, 10)

    found = [
        record("database", "database_landmarks", "count", landmarks),
        record("database", "database_facets", "count", 2 * landmarks - 4),
        record("recognition", "n_landmarks", "median", 55.0),
        record("prior", "position_error_m", "median", 45.0),
        record("recognition", "position_error_m", "median", position),
        record("recognition", "attitude_error_deg", "median", 1.5),
    ]
    if against:
        found += [
            record("paired", "position_difference_m", "median", position - 20.0, against),
            record("paired", "failure_rate", "rate", 0.1, against),
            record("paired", "failure_rate", "rate of the other", 0.2, against),
        ]
    return found


def test_each_data_base_has_a_line_in_the_order_of_the_campaign():
    both = [*records("z-first", 400, 20.0), *records("a-second", 300, 25.0, "z-first")]
    grid = sensitivity_grid(both, [("s", "z-first"), ("s", "a-second")], load_published("rowell2015-simulated"))
    assert [row[1] for row in grid.rows] == ["the paper", "z-first", "a-second"]
    assert grid.rows[0][2:7] == ("409", "814", "59", "20.9 m", "0.58 deg")
    assert grid.rows[1][2:8] == ("400", "796", "55.0", "20.0 [19.0, 21.0]", "1.50 [0.500, 2.50]", "9/10")
    assert grid.rows[1][8:] == ("0.200", "-", "-")
    assert grid.rows[2][8:] == ("0.100", "5.00 [4.00, 6.00]", "-")
    assert all(len(row) == len(grid.columns) for row in grid.rows)


def test_one_data_base_needs_no_table():
    assert sensitivity_grid(records("only", 400, 20.0), [("s", "only")]) is None


def run_with(*products):
    manifest = Manifest(
        name="c", seed=0, trials=1, scenarios={"s": {}}, estimators=(), versions={}, machine={}, credits=(),
        products=[
            StoredProduct(kind="k", scenario="s", estimator=estimator, folder=folder, n_landmarks=4, n_facets=facets)
            for estimator, folder, facets in products
        ],
    )  # fmt: skip
    return RunData(Path(), manifest, pd.DataFrame())


def test_estimators_with_one_data_base_are_no_variants_of_it():
    assert mesh_variants(run_with(("harris", "a", 4), ("ransac", "a", 4))) == []
    assert mesh_variants(run_with(("harris", "a", 4), ("sift", "b", None))) == []
    variants = mesh_variants(run_with(("first", "b", 4), ("second", "a", 4), ("sift", "c", None)))
    assert variants == [("s", "first"), ("s", "second")]
