"""Labelled posteriors, forces, checks, comparison, plots and the reports.

Of several functions of one name - each analysis has a ``sentence`` of its own - the module says
which is meant.
"""

import lazy_loader

if __name__ != "swarmssm.analysis":
    raise ImportError("Write swarmssm.analysis: analysis at the root is but a link.")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
