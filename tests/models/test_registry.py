"""Find models by name, and the user's own by ``module:attribute``."""

import sys
import uuid
from dataclasses import replace

import pytest

from swarmssm.errors import InputError
from swarmssm.inference.guides import GUIDES, default_guide, describe_guide
from swarmssm.models import MODELS, GraphVAE, describe_model, find_model
from swarmssm.models.description import UNIT
from swarmssm.models.presets import boids, graph_ssm
from swarmssm.models.registry import find_part

OWN = "from swarmssm.models import GraphVAE\nclass Own(GraphVAE):\n    place = {!r}\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Work in an empty folder, and forget what was imported from it."""
    before = set(sys.modules), list(sys.path)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before[0]:
        if str(getattr(sys.modules[name], "__file__", None)).startswith(str(tmp_path)):
            del sys.modules[name]
    assert sys.path == before[1]


@pytest.fixture
def name():
    """Return a name that no module has."""
    return f"own_{uuid.uuid4().hex}"


def test_registered_names_come_first(folder):
    assert find_model("graph-vae") == GraphVAE.for_scales
    assert MODELS["graph-vae"].build is GraphVAE
    (folder / "graph-vae.py").write_text("raise RuntimeError")
    assert find_model("graph-vae") == GraphVAE.for_scales


def find_own(name):
    """Return what a name stands for."""
    return find_part(name, {}, "model")


def test_a_file_in_the_current_folder(folder, name):
    (folder / f"{name}.py").write_text(OWN.format("here"))
    own = find_own(f"{name}:Own")
    assert issubclass(own, GraphVAE)
    assert own.place == "here"
    # Once imported it stays the same class; a name with its ending means the same file.
    assert find_own(f"{name}:Own") is own
    assert find_own(f"{name}.py:Own") is own


def test_an_installed_module(folder):
    assert find_part("swarmssm.models.graph_vae:GraphVAE", {}, "model") is GraphVAE


def test_the_file_of_the_folder_that_we_are_in_now(folder, name, monkeypatch):
    """Two folders with files of one name, and a file that bears the name of an installed module."""
    for place in ("one", "two"):
        (folder / place).mkdir()
        (folder / place / f"{name}.py").write_text(OWN.format(place))
    import json

    (folder / "two" / "json.py").write_text(OWN.format("two"))
    for place in ("one", "two", "one"):
        monkeypatch.chdir(folder / place)
        assert find_own(f"{name}:Own").place == place
    monkeypatch.chdir(folder / "two")
    assert find_own("json:Own").place == "two"
    assert sys.modules["json"] is json


def test_a_file_may_import_its_neighbours(folder, name):
    (folder / f"{name}.py").write_text(f"from {name}_parts import Own")
    (folder / f"{name}_parts.py").write_text(OWN.format("neighbour"))
    assert find_own(f"{name}:Own").place == "neighbour"


def test_a_package_in_the_current_folder(folder, name):
    (folder / name).mkdir()
    (folder / name / "__init__.py").touch()
    (folder / name / "inner.py").write_text(OWN.format("inner"))
    assert find_own(f"{name}.inner:Own").place == "inner"


def test_what_cannot_be_found_is_said(folder, name):
    (folder / f"{name}.py").write_text(OWN.format("here") + "number = 3\n")
    (folder / f"{name}_asks.py").write_text("import no_such_module_anywhere")
    (folder / f"{name}_fails.py").write_text("1 / 0")
    (folder / f"{name}_typo.py").write_text("class Own(:")
    (folder / f"{name}_leaves.py").write_text("import sys\nsys.exit(3)")
    cases = {
        "graf-vae": "'graf-vae' is unknown. Choose one of .*graph-vae",
        f"{name}": "or name your own as module:attribute",
        f"{name}:": "or name your own as module:attribute",
        ":Own": "or name your own as module:attribute",
        f"{name}:Other": f"{name} has no class or function Other",
        f"{name}:number": f"{name} has no class or function number",
        "no_such_thing:Own": "no module no_such_thing, neither as no_such_thing.py in the current",
        "no_such_thing.inner:Own": r"there is no module no_such_thing\.inner",
        f"{name}_asks:Own": "importing .*_asks failed: No module named 'no_such_module_anywhere'",
        f"{name}_fails:Own": "failed: ZeroDivisionError: division by zero",
        f"{name}_typo:Own": "failed: SyntaxError",
        f"{name}_leaves:Own": "failed: SystemExit: 3",
        "..own:Own": r"importing \.\.own failed",
    }
    for text, sentence in cases.items():
        with pytest.raises(InputError, match=sentence) as caught:
            find_part(text, MODELS, "guide")
        assert str(caught.value).startswith("guide: ")
        assert len(str(caught.value).splitlines()) == 1
    # A file that failed can be mended and tried again.
    (folder / f"{name}_fails.py").write_text(OWN.format("mended"))
    assert find_own(f"{name}_fails:Own").place == "mended"


def test_a_description_has_options_and_priors():
    found = describe_model("boids")
    assert found.title == MODELS["boids"].title
    assert found.options.loc["walls", "default"] == "true"
    assert "velocity" in found.options.loc["form", "values"]
    assert found.options["description"].str.len().min() > 10
    assert found.priors.loc["transition.cohesion_gain", "prior"] == "LogNormal(0, 1.5)"
    wide = describe_model("boids", replace(UNIT, length=10.0))
    assert wide.priors.loc["transition.cohesion_gain", "prior"] == "LogNormal(-4.605, 1.5)"
    # A class has the options of its constructor, and no states to infer a prior of.
    vae = describe_model("graph-vae")
    assert vae.options.loc["latent_dim", "default"] == "4"
    assert vae.priors.empty


@pytest.mark.parametrize("name", MODELS)
def test_every_option_of_every_model_is_described(name):
    found = describe_model(name)
    assert (found.options["description"] != "").all(), found.options
    assert found.description.endswith(".")


@pytest.mark.parametrize("name", GUIDES)
def test_every_option_of_every_guide_is_described(name):
    found = describe_guide(name)
    assert (found.options["description"] != "").all(), found.options


@pytest.mark.parametrize(
    ("build", "guide"),
    [
        (lambda: boids(UNIT), "linearized"),
        (lambda: boids(UNIT, observed="states"), "parameters"),
        (lambda: graph_ssm(UNIT), "markov"),
        (lambda: GraphVAE(4), "encoder"),
    ],
)
def test_the_default_guide_follows_from_properties_alone(build, guide):
    assert default_guide(build()) == guide
