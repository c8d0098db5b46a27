"""One container of labelled results, whichever ArviZ is installed."""

from collections.abc import Mapping
from typing import Any

import lazy_loader
import xarray as xr

__all__ = ["container_of"]

#: Imported when it is first used, since that takes seconds.
arviz = lazy_loader.load("arviz")


def container_of(groups: Mapping[str, xr.Dataset], attrs: Mapping[str, Any]) -> Any:
    """Put groups together: an ``InferenceData`` of ArviZ before 1.0, a ``DataTree`` since.

    Parameters
    ----------
    groups
        Name -> dataset, in ArviZ's names.
    attrs
        Of the whole.
    """
    inference_data = getattr(arviz, "InferenceData", None)
    # ArviZ 1 keeps the name for a while as one of xarray's own class.
    if inference_data is None or inference_data is xr.DataTree:
        tree = xr.DataTree.from_dict({f"/{name}": group for name, group in groups.items()})
        tree.attrs.update(attrs)
        return tree
    return inference_data(attrs=dict(attrs), **groups)
