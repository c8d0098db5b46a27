"""What an analysis found: a dataset for each question, in one file."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import xarray as xr

from swarmssm import io
from swarmssm.errors import InputError

__all__ = ["ANALYSES", "FORMAT", "Analysis"]

#: The questions to one fit, in the order in which they are asked and told.
ANALYSES = ("forces", "kernels", "force_maps", "latents", "influence")
#: What stands beside the answers.
BESIDE = ("edges", "scores", "parameters")
#: Stands at the root of a file of an analysis.
FORMAT = "swarmssm analysis 1"


@dataclass(frozen=True)
class Analysis:
    """What a fitted model says of tracks; see :func:`swarmssm.analysis.interpretation.analyze`.

    Each dataset is ``None`` where it was not asked for or cannot be had of the model or the tracks;
    ``notes`` then say why.

    Attributes
    ----------
    forces
        Draws of :func:`swarmssm.analysis.posterior_forces`, with the magnitudes and angles
        of :func:`swarmssm.analysis.force_summary`. Of long recordings each
        ``attrs["stride"]``-th frame. Of simulated tracks also ``truth_r_squared``, ``truth_slope``
        and ``truth_coverage (term)``, see :func:`swarmssm.analysis.force_agreement`.
    kernels
        Of :func:`swarmssm.analysis.interaction_kernels`; of simulated boids with the true
        ones as ``truth_net``, ``truth_alignment`` ... ``(distance)``, and ``truth_error`` and
        ``truth_inside (kernel)``, the error and the coverage of
        :func:`swarmssm.analysis.kernel_agreement`.
    force_maps
        Of :func:`swarmssm.analysis.force_maps`.
    latents
        Of :func:`swarmssm.analysis.latent_force_alignment`.
    influence
        Of ``influence``, with ``leader_alarm``, ``leads`` and
        ``loner (individual)`` of ``leaders``, decided at the rate
        ``attrs["leader_rate"]``.
    edges
        Of ``inferred_edges``, of a model that infers them.
    scores
        Of :func:`swarmssm.analysis.scoring.backtest`: forecasts of held-out frames by the fit and
        its rivals.
    parameters
        ``mean``, ``sd``, ``low`` and ``high (parameter)`` of the parameters that have a prior, see
        :meth:`swarmssm.inference.Fit.parameter_table`.
    sentences
        For each dataset that is there, what it shows and how far it can be believed.
    settings
        Model, guide, part, draws, seed and version.
    notes
        What a reader has to know: what was left out, and why.
    """

    forces: xr.Dataset | None = None
    kernels: xr.Dataset | None = None
    force_maps: xr.Dataset | None = None
    latents: xr.Dataset | None = None
    influence: xr.Dataset | None = None
    edges: xr.Dataset | None = None
    scores: xr.Dataset | None = None
    parameters: xr.Dataset | None = None
    sentences: dict[str, str] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def datasets(self) -> dict[str, xr.Dataset]:
        """The datasets that are there, by name."""
        found = {name: getattr(self, name) for name in (*ANALYSES, *BESIDE)}
        return {name: dataset for name, dataset in found.items() if dataset is not None}

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write one NetCDF-4 file with a group for each dataset.

        ``xarray.open_datatree(path)`` opens all of it, ``xarray.open_dataset(path,
        group="kernels")`` one.

        Raises
        ------
        InputError
            If ``path`` exists or cannot be written to.
        WorkError
            If writing fails.
        """
        attrs = {
            "format": FORMAT,
            "settings": self.settings,
            "sentences": self.sentences,
            "notes": list(self.notes),
        }
        io.write_groups(self.datasets, path, attrs=attrs, overwrite=overwrite)

    @classmethod
    def read(cls, path: str | Path) -> "Analysis":
        """Read what :meth:`write` wrote.

        Raises
        ------
        InputError
            If there is no such file, it is damaged, or holds something else.
        """
        groups, attrs = io.read_groups(path)
        known = {part.name for part in fields(cls)} & groups.keys()
        if attrs.get("format") != FORMAT or known != groups.keys():
            raise InputError(
                f"{path}: it is no file of swarmssm analyze. Make one with swarmssm analyze RUN "
                "TRACKS --out FILE."
            )
        return cls(
            **groups,
            sentences=dict(attrs["sentences"]),
            settings=dict(attrs["settings"]),
            notes=tuple(attrs["notes"]),
        )
