"""``swarmssm report --compare``: one page on several analyses; mistakes leave nothing behind."""

import shutil

import pytest


@pytest.fixture(scope="module")
def analysed(flock_file, run_folder, tmp_path_factory):
    """A file of forces alone."""
    from swarmssm import inference, io
    from swarmssm.analysis.interpretation.analyze import analyze

    path = tmp_path_factory.mktemp("analysed") / "flock a.nc"
    fit = inference.Fit.load(run_folder)
    analyze(fit, io.read(flock_file), draws=1, only=["forces"]).write(path)
    return path


def test_names_title_and_text(swarmssm, analysed, tmp_path):
    shutil.copy(analysed, tmp_path / "b=c.nc")
    (tmp_path / "words.md").write_text("# Said\n\nof *flocks*\n")
    result = swarmssm(
        *("report", "--compare", analysed, f"second={analysed}", "b=c.nc"),
        *("--out", "page.html", "--title", "Three", "--text", "words.md"),
    )
    assert result.status == 0, result.err
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<h1>Three</h1>" in page
    assert "<em>flocks</em>" in page
    for name in ("flock a", "second", "b=c"):
        assert f'<th scope="col">{name}</th>' in page


def test_one_file_will_do(swarmssm, analysed, tmp_path):
    result = swarmssm("report", "--compare", f"one={analysed}", "--out", "page.html")
    assert result.status == 0, result.err
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "one: its analysis has no force maps." in page


MISTAKES = {
    "no file": (["absent.nc"], "absent.nc"),
    "no analysis": (["{flock}"], "no file of swarmssm analyze"),
    "no NetCDF": (["a=words.txt"], "words.txt"),
    "one name twice": (["a={file}", "a={file}"], "a set named a is given twice"),
    "one file twice": (["{file}", "{file}"], "NAME=FILE"),
    "no name": (["={file}"], "NAME=FILE"),
    "no place": (["a="], "NAME=FILE"),
    "no text": (["{file}", "--text", "absent.md"], "absent.md"),
    "folder as text": (["{file}", "--text", "."], "cannot be read"),
    "binary text": (["{file}", "--text", "{file}"], "UTF-8"),
    "nothing at all": ([], "FILE"),
    "data": (["{file}", "--data", "x.nc"], "--data"),
    "against": (["{file}", "--against", "x"], "--against"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_and_leaves_nothing(swarmssm, analysed, flock_file, tmp_path, name):
    (tmp_path / "words.txt").write_text("words")
    arguments, fragment = MISTAKES[name]
    filled = [one.format(file=analysed, flock=flock_file) for one in arguments]
    result = swarmssm("report", "--compare", *filled, "--out", "page.html")
    assert result.status == 2, result
    assert fragment in result.err
    assert "Traceback" not in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["words.txt"]


def test_what_exists_is_kept_unless_asked(swarmssm, analysed, tmp_path):
    page = tmp_path / "page.html"
    page.write_text("precious")
    result = swarmssm("report", "--compare", analysed, "--out", "page.html")
    assert result.status == 2
    assert page.read_text() == "precious"
    result = swarmssm("report", "--compare", analysed, "--out", "page.html", "--overwrite")
    assert result.status == 0, result.err
    assert page.read_text(encoding="utf-8").startswith("<!")


def test_what_is_read_is_not_written_over(swarmssm, analysed, tmp_path):
    own = tmp_path / "own.nc"
    shutil.copy(analysed, own)
    before = own.read_bytes()
    result = swarmssm("report", "--compare", "own.nc", "--out", "own.nc", "--overwrite")
    assert result.status == 2
    assert "is read" in result.err
    assert own.read_bytes() == before


def test_one_run_is_reported_at_a_time(swarmssm, analysed, run_folder, tmp_path):
    for more, said in (([run_folder], "one run"), (["--text", "a.md"], "--compare")):
        result = swarmssm("report", run_folder, *more, "--out", "page.html")
        assert result.status == 2
        assert said in result.err
    assert not list(tmp_path.iterdir())
