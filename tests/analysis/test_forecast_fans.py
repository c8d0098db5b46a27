"""Fans hold the shares of draws that they say, and their pictures show them."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import LineCollection
from matplotlib.patches import Ellipse

from swarmssm.analysis.plots.forecasts import plot_forecast, plot_forecast_over_time
from swarmssm.analysis.scoring.forecast_fans import fan_verdict, forecast_fan
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks

DRAWS = 4000
#: Standard deviations of the draws along x and y, and their correlation.
WIDE, TALL, TIED = 3.0, 1.0, 0.5


@pytest.fixture(scope="module")
def tracks():
    """Two at 10 frames a second: a goes right, b up, 1 a frame; b is lost in frame 13."""
    position = np.zeros((20, 2, 2))
    position[:, 0, 0] = np.arange(20)
    position[:, 1, 1] = np.arange(20)
    position[13, 1] = np.nan
    return make_tracks(position, fps=10, individuals=["a", "b"], unit="m")


def forecast_of(tracks, steps=5, end=9, draws=DRAWS, seed=0):
    """Draw what comes after a row: Gaussian about what came."""
    generator = np.random.default_rng(seed)
    spread = np.array([[WIDE, 0.0], [TALL * TIED, TALL * np.sqrt(1 - TIED**2)]])
    noise = generator.standard_normal((draws, 1, steps, 2, 2)) @ spread.T
    truth = np.zeros((1, steps, 2, 2))
    rows = end + 1 + np.arange(steps)
    truth[0, :, 0, 0] = truth[0, :, 1, 1] = rows
    values = np.swapaxes(truth + noise, -1, -2)
    return xr.Dataset(
        {"position": (("draw", "trial", "time", "space", "individual"), values)},
        {
            "trial": ["0"],
            "time": rows / 10,
            "space": ["x", "y"],
            "individual": ["a", "b"],
            "history_end": ("trial", [end / 10]),
        },
    )


@pytest.fixture(scope="module")
def fan(tracks):
    return forecast_fan(forecast_of(tracks), tracks, levels=(0.5, 0.9), history=4)


def test_history_and_future_are_those_of_the_tracks(fan, tracks):
    path = tracks["position"].transpose("time", "individual", "space").to_numpy()
    np.testing.assert_array_equal(fan["history"][0], path[6:10])
    np.testing.assert_array_equal(fan["observed"][0], path[10:15])
    np.testing.assert_allclose(fan["ahead"], [0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(fan["behind"], [-0.3, -0.2, -0.1, 0.0])
    assert float(fan["start"][0]) == pytest.approx(0.9)


def test_intervals_are_the_quantiles_of_a_gaussian(fan):
    # Six standard errors of a quantile: sqrt(q (1 - q) / n) / density.
    for level, away in ((0.5, 0.67449), (0.9, 1.64485)):
        share = (1 + level) / 2
        density = np.exp(-(away**2) / 2) / np.sqrt(2 * np.pi)
        most = 6 * np.sqrt(share * (1 - share) / DRAWS) / density
        half = (fan["high"] - fan["low"]).sel(level=level) / 2
        np.testing.assert_allclose(half.sel(space="x"), WIDE * away, atol=WIDE * most)
        np.testing.assert_allclose(half.sel(space="y"), TALL * away, atol=TALL * most)


def test_ellipses_reach_as_far_as_the_law_of_rayleigh_says(fan):
    # In two dimensions the distance in standard deviations has P(d <= r) = 1 - exp(-r^2 / 2).
    for level in (0.5, 0.9):
        expected = np.sqrt(-2 * np.log(1 - level))
        density = expected * (1 - level)
        most = 6 * np.sqrt(level * (1 - level) / DRAWS) / density
        np.testing.assert_allclose(fan["reach"].sel(level=level), expected, atol=most)
    covariance = np.array([[WIDE**2, TIED * WIDE * TALL], [TIED * WIDE * TALL, TALL**2]])
    most = 6 * WIDE**2 * np.sqrt(2 / DRAWS)
    np.testing.assert_allclose(fan["covariance"][0, 0, 0], covariance, atol=most)


def test_ellipses_of_few_draws_hold_one_more_as_often_as_they_say(tracks):
    """Of 2000 forecasts with 20 draws each, what comes from the same law is inside in 80 %."""
    generator = np.random.default_rng(1)
    inside = []
    whole = tracks.isel(individual=[0])
    for seed in range(100):
        forecast = forecast_of(tracks, steps=5, draws=20, seed=seed).isel(individual=[0])
        came = whole.copy(deep=True)
        noise = generator.standard_normal((5, 2)) @ np.array(
            [[WIDE, TALL * TIED], [0, TALL * 0.866]]
        )
        came["position"][10:15] = came["position"][10:15].to_numpy() + noise[..., None]
        inside.append(forecast_fan(forecast, came, levels=[0.8])["inside"])
    share = float(np.mean(inside))
    # Six standard errors of 500, and what an ellipse of 20 draws of its own lacks: about 2 / 20.
    assert abs(share - 0.8) <= 6 * np.sqrt(0.16 / 500) + 0.1


def test_what_came_is_inside_or_not_or_unknown(tracks):
    moved = tracks.copy(deep=True)
    moved["position"][11, :, 0] = [500.0, 0.0]
    fan = forecast_fan(forecast_of(tracks), moved, levels=(0.5, 0.9))
    inside = fan["inside"].sel(level=0.9)[0]
    assert inside.sel(individual="a").values.tolist() == [1.0, 0.0, 1.0, 1.0, 1.0]
    assert np.isnan(inside.sel(individual="b").to_numpy()).tolist() == [
        False,
        False,
        False,
        True,
        False,
    ]
    text = fan_verdict(fan)
    assert "Of 9 observed positions, 89 % lay inside the ellipse that should hold 90 %" in text
    assert "100 % at the last step, 0.5 s ahead" in text
    assert "one start alone" in text


def test_the_end_of_the_tracks_is_no_end_of_the_forecast(tracks):
    fan = forecast_fan(forecast_of(tracks, end=19), tracks)
    assert np.isnan(fan["observed"]).all()
    assert "No position was observed" in fan_verdict(fan)
    plot_forecast(fan)
    short = forecast_fan(forecast_of(tracks, end=1), tracks, history=5)
    assert np.isnan(short["history"][0, :3]).all()


def test_it_is_made_of_a_fit(quick_fit, boids):
    forecast = quick_fit.forecast(boids.isel(time=slice(0, 30)), 5, draws=12)
    fan = forecast_fan(forecast, boids)
    np.testing.assert_allclose(
        fan["observed"], boids["position"][:, 30:35].transpose(..., "individual", "space")
    )
    assert fan.sizes["trial"] == 4
    assert fan["median"].attrs == {"units": ""}


def test_mistakes_are_told(tracks):
    forecast = forecast_of(tracks, draws=20)
    with pytest.raises(InputError, match="it has no draws"):
        forecast_fan(forecast.isel(draw=0), tracks)
    with pytest.raises(InputError, match="5 draws are too few"):
        forecast_fan(forecast.isel(draw=slice(0, 5)), tracks)
    with pytest.raises(InputError, match="levels: each must lie between 0 and 1"):
        forecast_fan(forecast, tracks, levels=[1.0])
    with pytest.raises(InputError, match="history: it must be at least 1"):
        forecast_fan(forecast, tracks, history=0)
    with pytest.raises(InputError, match="they are 0 and other"):
        forecast_fan(forecast.assign_coords(trial=["other"]), tracks)
    with pytest.raises(InputError, match=r"goes on from 0.9 s, and they run from 0 s to 0.4 s"):
        forecast_fan(forecast, tracks.isel(time=slice(0, 5)))


def test_a_picture_in_space_shows_draws_truth_and_ellipses(fan):
    figure, ax = plot_forecast(fan, draws=7)
    assert ax.figure is figure
    assert ax.get_title() == "0.5 s ahead from 0.9 s"
    drawn = [c for c in ax.collections if isinstance(c, LineCollection)]
    assert [len(one.get_segments()) for one in drawn] == [7, 7]
    # A draw begins where the history ends.
    begin = fan["history"][0, -1, 0]
    segment = drawn[0].get_segments()[2]
    np.testing.assert_allclose(segment[0], begin)
    np.testing.assert_allclose(segment[1:], fan["draws"][2, 0, :, 0])
    ellipses = [patch for patch in ax.patches if isinstance(patch, Ellipse)]
    assert len(ellipses) == 4
    widest, inner = ellipses[:2]
    np.testing.assert_allclose(widest.center, fan["center"][0, -1, 0])
    # Points on its edge lie at the distance that it should reach.
    turn = np.linspace(0.0, 2 * np.pi, 9)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    edge = widest.get_patch_transform().transform(circle)
    off = edge - fan["center"][0, -1, 0].to_numpy()
    inverse = np.linalg.inv(fan["covariance"][0, -1, 0])
    far = np.sqrt(np.einsum("ni,ij,nj->n", off, inverse, off))
    np.testing.assert_allclose(far, float(fan["reach"].sel(level=0.9)[0, -1, 0]), rtol=1e-6)
    assert inner.width < widest.width
    truth = ax.lines[1].get_xydata()
    np.testing.assert_array_equal(truth[1:], fan["observed"][0, :, 0])


def test_a_picture_over_time_shows_bands_and_what_came(fan):
    figure, axes = plot_forecast_over_time(fan, individuals=["b"])
    assert axes.shape == (1, 2)
    assert axes[0, 1].get_ylabel() == "y of b (m)"
    median, path = axes[0, 1].lines[:2]
    np.testing.assert_array_equal(median.get_ydata(), fan["median"][0, :, 1, 1])
    np.testing.assert_array_equal(
        path.get_ydata(), np.concatenate([fan["history"][0, :, 1, 1], fan["observed"][0, :, 1, 1]])
    )
    corners = axes[0, 1].collections[0].get_paths()[0].vertices
    assert corners[:, 1].max() == pytest.approx(float(fan["high"][1, 0, :, 1, 1].max()))
    assert [text.get_text() for text in figure.legends[0].get_texts()][2:] == ["90 %", "50 %"]


def test_pictures_choose_and_refuse(fan):
    _, ax = plot_forecast(fan, individuals=["a"], steps=[1, 3], draws=0, title="only a")
    assert ax.get_title() == "only a"
    assert len([patch for patch in ax.patches if isinstance(patch, Ellipse)]) == 4
    for draw in (plot_forecast, plot_forecast_over_time):
        with pytest.raises(InputError, match="individuals: there is no 'q'; there are a, b"):
            draw(fan, individuals=["q"])
        with pytest.raises(InputError, match="trial: there is no 'q'; there are 0"):
            draw(fan, trial="q")
    with pytest.raises(InputError, match="steps: the forecast has no step 6; it has 1 to 5"):
        plot_forecast(fan, steps=[6])
    nobody = fan.assign(median=fan["median"] * np.nan)
    with pytest.raises(InputError, match="in trial 0 nobody is forecast"):
        plot_forecast(nobody)
