"""All baselines by name, each imported when it is asked for: some need libraries of their own."""

import importlib

from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.errors import InputError
from swarmssm.models.registry import find_part

__all__ = ["BASELINES", "baseline_named"]

PLACE = "swarmssm.baselines"
#: Name -> module of this folder (or of the package, in full) and class.
BASELINES = {
    "stay-put": "swarmssm.analysis.scoring.references:StayPut",
    "constant-velocity": "swarmssm.analysis.scoring.references:ConstantVelocity",
    "kalman": "kalman:KalmanVelocity",
    "imm": "interacting:InteractingModels",
    "ar1": "autoregression:AR1",
    "ar5": "autoregression:AR5",
    "ridge-boids": "ridge_boids:RidgeBoids",
    "sindy-boids": "sindy:SindyBoids",
    "sindy-generic": "sindy:SindyGeneric",
    "sindy-oracle": "sindy_oracle:SindyOracle",
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


def baseline_named(name: str) -> type[Baseline]:
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
    full = module if "." in module else f"{PLACE}.{module}"
    try:
        found: type[Baseline] = getattr(importlib.import_module(full), attribute)
    except ModuleNotFoundError as error:
        raise InputError(
            f"{name}: the library {error.name} is not installed. pip install 'swarmssm[benchmark]' "
            "brings it."
        ) from error
    return found
