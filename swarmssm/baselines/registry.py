"""All baselines by name, each imported when it is asked for: some need libraries of their own."""

import importlib

from swarmssm.baselines.base import Baseline
from swarmssm.errors import InputError
from swarmssm.models.registry import find_part

__all__ = ["BASELINES", "UNSEEDED", "rival"]

PLACE = "swarmssm.baselines"
#: Name -> module and class.
BASELINES = {
    "stay-put": "stay_put:StayPut",
    "constant-velocity": "constant_velocity:ConstantVelocity",
    "kalman": "kalman:KalmanVelocity",
    "imm": "interacting:InteractingModels",
    "ar1": "autoregression:AR1",
    "ar5": "autoregression:AR5",
    "ridge-boids": "ridge_boids:RidgeBoids",
    "sindy-boids": "sindy:SindyBoids",
    "sindy-generic": "sindy:SindyGeneric",
    "sindy-told": "sindy_told:SindyTold",
    "sindy-pi": "sindy_pi:SindyPI",
    "sindy-autoencoder": "sindy_autoencoder:SindyAutoencoder",
    "lstm": "lstm:LSTM",
    "dcrnn": "dcrnn:DCRNN",
    "dcrnn-direct": "dcrnn:DCRNNDirect",
    "dygrencoder": "dygrencoder:DyGrEncoder",
    "dygrencoder-direct": "dygrencoder:DyGrEncoderDirect",
    "swarmnet": "swarmnet:SwarmNet",
    "knode": "knode:KNODE",
    "nri": "nri:NeuralRelationalInference",
    "nri-rnn": "nri:RecurrentRelationalInference",
    "dnri": "dnri:DynamicRelationalInference",
}
#: Those that draw nothing while they learn.
UNSEEDED = frozenset(
    {
        "stay-put",
        "constant-velocity",
        "kalman",
        "imm",
        "ar1",
        "ar5",
        "ridge-boids",
        "sindy-boids",
        "sindy-generic",
        "sindy-told",
        "sindy-pi",
    }
)


def rival(name: str) -> type[Baseline]:
    """Return a baseline by its name.

    Parameters
    ----------
    name
        One of :data:`BASELINES`, or ``module:attribute`` of your own subclass of
        :class:`~swarmssm.baselines.Baseline`. Importing a module runs its code.

    Raises
    ------
    InputError
        If there is no such baseline, or a library that it needs is not installed.
    """
    if name not in BASELINES:
        own = find_part(name, dict.fromkeys(BASELINES), "method")
        if not (isinstance(own, type) and issubclass(own, Baseline)):
            raise InputError(f"method: {name} is no Baseline. Make it a subclass of Baseline.")
        return own
    module, _, attribute = BASELINES[name].partition(":")
    try:
        found: type[Baseline] = getattr(importlib.import_module(f"{PLACE}.{module}"), attribute)
    except ModuleNotFoundError as error:
        raise InputError(
            f"{name}: the library {error.name} is not installed. pip install 'swarmssm[benchmark]' "
            "brings it."
        ) from error
    return found
