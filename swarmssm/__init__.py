"""Learn how the members of a group move each other, from their tracks alone.

A state-space model is fitted to tracks by variational inference. Its parameters are the forces
that act between individuals, each with a posterior; its forecasts and free runs say how far to
trust them::

    import swarmssm as sw

    tracks = sw.simulate_boids(individuals=8, steps=200, observation_noise=0.02, seed=0)
    fit = sw.fit("boids", tracks, seed=0)      # sw.read("fish.csv") gives tracks of your own
    print(fit)                                  # the model, the data, and whether it converged
    print(fit.summary())                        # each parameter, its unit and 90 % interval
    test = fit.part(tracks, "test")             # the last 15 %, which the fit has not seen
    scores = sw.analysis.evaluate(fit, tracks)  # forecasts, and those of simple baselines
    future = fit.forecast(test, horizon=50)     # draws, as an xarray Dataset
    fit.save("run", overwrite=True)             # sw.Fit.load("run") gives it back

Offered here are :func:`read`, :func:`fit`, :class:`Fit`, :func:`simulate_boids`, and the
sub-packages :mod:`~swarmssm.models` (the parts of a model), :mod:`~swarmssm.inference` (guides,
filters, prediction), :mod:`~swarmssm.analysis` (scores, checks, forces, reports),
``plots`` (figures of their results) and :mod:`~swarmssm.datasets` (recordings that come with the
package). ``swarmssm --help`` lists the same work as commands.
"""

from importlib.metadata import version

import lazy_loader

# What a name stands for is imported when the name is first used: the stub beside this file lists
# the names, for type checkers too.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = version("swarmssm")
