"""Scores, checks and interpretation of a fit, figures of them, and reports.

* :func:`evaluate`, :func:`score` and :func:`compare`: forecasts of held-out frames.
* :func:`check`, :func:`sbc`, :func:`recovery`: posterior predictive checks, calibration, recovery.
* :func:`analyze`: forces, kernels, force maps, latents, influence and delays with one verdict; each
  stands alone too (:func:`posterior_forces`, :func:`interaction_kernels`, :func:`force_maps`,
  :func:`latent_force_alignment`, :func:`inferred_edges`, :func:`leadership_delays`).
* ``plots``: figures of all of these; ``report``: pages.

Names are loaded when they are first used.
"""

import lazy_loader

if __name__ != "swarmssm.analysis":
    raise ImportError("Write swarmssm.analysis: analysis at the root is but a link.")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
