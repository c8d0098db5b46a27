"""What stands in the tables of several sets."""

from dataclasses import replace

from swarmssm.analysis.report.side_by_side import fact_rows, finding_rows


def test_thinned_frames_are_said(flock):
    thin = replace(
        flock,
        forces=flock.forces.isel(time=slice(None, None, 3)).assign_attrs(stride=3),
        influence=None,
    )
    told = dict(fact_rows({"a": flock, "b": thin}))
    # The last of 60 frames at 10 a second is 5.9 s after the first, the last kept one 5.7 s.
    assert told["frames"] == ["60, 5.90 s", "about 60, 5.70 s; one in 3 kept"]


def test_what_is_not_told_is_a_dash(flock):
    bare = replace(flock, forces=None, influence=None, settings={})
    told = dict(fact_rows({"a": bare}))
    for label in ("individuals", "trials", "frames", "model", "draws"):
        assert told[label] == ["–"], label


def test_rows_of_all_sets_keep_their_order(flock, sparse):
    alone = [(row.group, row.label) for row in finding_rows({"a": flock})]
    both = finding_rows({"b": sparse, "a": flock})
    assert [(row.group, row.label) for row in both] == alone
    groups = [row.group for row in both]
    assert list(dict.fromkeys(groups)) == ["forces", "kernels", "force maps"]
    assert groups == sorted(groups, key=["forces", "kernels", "force maps"].index)
    assert all(len(row.cells) == 2 for row in both)
    assert [row.cells[0].value for row in both if row.group == "kernels"] == ["–"] * groups.count(
        "kernels"
    )
