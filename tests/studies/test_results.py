"""Statistics of streaming chunks are those of all rows."""

import numpy as np
import pandas as pd
import pytest
from toy_study import STUDY

from studies.harness import Study, StudyError, aggregate, iter_chunks, load, results, sweep


def holed(scenario, n_sets, rng):
    """Repetitions that fail, values that do not apply, and a method that always fails."""
    rows = pd.DataFrame({"repetition": np.tile(np.arange(n_sets), 3), "method": np.repeat(["a", "b", "c"], n_sets)})
    ok = rng.random(3 * n_sets) > 0.3
    x = 1e6 + rng.normal(size=3 * n_sets)  # far from 0: a sum of squares would lose its digits
    return rows.assign(
        ok=ok & (rows["method"] != "c"),
        x=np.where(rng.random(3 * n_sets) > 0.1, x, np.nan),
        y=np.where(rng.random(3 * n_sets) > 0.1, rng.exponential(size=3 * n_sets), np.inf),
        level=None if scenario["key"] == "none" else 1.5,
    )


HOLED = Study("holed", holed, [{"key": "none"}, {"key": "some"}], sets=95, chunk_size=10)


@pytest.fixture(scope="module", params=[50, 10**6], ids=["blocks", "at once"])
def out(request, tmp_path_factory):
    out = tmp_path_factory.mktemp("holed")
    sweep(HOLED, out)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(results, "BLOCK", request.param)
        yield out


def test_aggregate_equals_pandas_on_all_rows(out):
    found = aggregate(out, ["scenario", "method"], ["x", "y"], quantiles=[0.1, 0.5]).set_index("value", append=True)
    rows = load(out).replace([np.inf], np.nan).melt(["scenario", "method"], ["x", "y"], "value", "number")
    groups = rows.groupby(["scenario", "method", "value"])["number"]
    size = groups.size()
    expected = groups.agg(["count", "mean", "sem", "std", "min", "max"]).assign(
        failures=size - groups.count(),
        missing=0,
        rms=groups.agg(lambda x: np.sqrt(np.mean(x**2))),
        **{f"q{level}": groups.quantile(level) for level in (0.1, 0.5)},
    )
    pd.testing.assert_frame_equal(found.sort_index(), expected[found.columns], rtol=1e-12, check_dtype=False)
    assert (found["failures"] > 0).all()


def test_rows_that_are_not_ok_are_failures_and_values_that_do_not_apply_are_missing(out):
    found = aggregate(out, ["scenario", "method"], ["x", "y"], ok="ok").set_index("value", append=True)
    rows = load(out)
    for (scenario, method, value), row in found.iterrows():
        mine = rows[(rows["scenario"] == scenario) & (rows["method"] == method)]
        good = mine.loc[mine["ok"], value]
        assert row["missing"] == good.isna().sum()
        assert row["failures"] == (~mine["ok"]).sum() + np.isinf(good).sum()
        assert row["count"] + row["failures"] + row["missing"] == len(mine) == 95
        assert row["count"] == np.isfinite(good).sum()
    never = found.xs("c", level="method")
    assert (never["count"] == 0).all()
    assert never["mean"].isna().all()


def test_groups_come_in_order_and_none_is_a_group(out):
    found = aggregate(out, ["scenario", "level"], "y")
    assert list(found.index.get_level_values("scenario")) == ["none", "some"]
    np.testing.assert_equal(found.index.get_level_values("level").to_numpy(float), [np.nan, 1.5])
    assert list(aggregate(out, "method", "y").index) == ["a", "b", "c"]


def test_statistics_are_equal_to_the_bit_for_other_workers(tmp_path):
    sweep(STUDY, tmp_path / "one")
    sweep(STUDY, tmp_path / "two", workers=2)
    one, two = (aggregate(tmp_path / out, ["scenario", "method"], "error") for out in ("one", "two"))
    pd.testing.assert_frame_equal(one, two, check_exact=True)


def test_chunks_and_columns(out):
    chunks = list(iter_chunks(out, ["method", "chunk"]))
    assert [len(chunk) for chunk in chunks] == [*[30] * 9, 15] * 2
    assert [chunk["chunk"].unique().tolist() for chunk in chunks] == [[number] for number in range(10)] * 2
    pd.testing.assert_frame_equal(pd.concat(chunks, ignore_index=True), load(out, ["method", "chunk"]))


def test_a_folder_without_a_sweep_is_told(tmp_path):
    with pytest.raises(StudyError, match="holds no sweep"):
        load(tmp_path)
