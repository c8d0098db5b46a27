"""Figures for a paper: files of a given width, with embedded fonts, their numbers and Methods."""

import pandas as pd
import pytest

from swarmssm.analysis.report.figures import write_analysis_files
from swarmssm.errors import InputError


def test_a_folder_holds_figures_tables_and_methods(flock, quick_fit, boids, tmp_path):
    folder = tmp_path / "figures"
    files = write_analysis_files(flock, quick_fit, boids, folder, format="svg", width=85.0)
    assert sorted(path.name for path in folder.iterdir()) == sorted(path.name for path in files)
    names = {path.name for path in files}
    assert {"kernels.csv", "forces.csv", "force_maps.csv", "influence.csv", "methods.md"} <= names
    assert sum(name.endswith(".svg") for name in names) >= 6
    curve = pd.read_csv(folder / "kernels.csv").query("kernel == 'net'")
    assert curve["median"].to_numpy() == pytest.approx(
        flock.to_pandas()["kernels"].query("kernel == 'net'")["median"].to_numpy()
    )
    methods = (folder / "methods.md").read_text()
    settings = quick_fit.settings
    frames = sum(part.stop - part.start for part in quick_fit.split.part("train"))
    for words in (settings.model, settings.guide, f"{frames} frames", "torch", flock.verdict()):
        assert str(words) in methods
    with pytest.raises(InputError, match="not empty"):
        write_analysis_files(flock, quick_fit, boids, folder)
    write_analysis_files(flock, quick_fit, boids, folder, format="svg", overwrite=True)
    assert {path.name for path in folder.iterdir()} == names


@pytest.mark.parametrize(("name", "words"), [("file", "it is a file"), ("a/b", "no folder")])
def test_a_folder_that_cannot_be_is_refused(flock, quick_fit, boids, tmp_path, name, words):
    (tmp_path / "file").write_text("precious")
    with pytest.raises(InputError, match=words):
        write_analysis_files(flock, quick_fit, boids, tmp_path / name)
    assert (tmp_path / "file").read_text() == "precious"
