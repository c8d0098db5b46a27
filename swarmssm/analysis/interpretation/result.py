"""The result of an analysis: a dataset for each question, in one file."""

import html
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from swarmssm import io
from swarmssm.analysis.interpretation.summary import formatted_summary, summary_of
from swarmssm.analysis.interpretation.tables import tables_of
from swarmssm.analysis.interpretation.verdict import verdict_of
from swarmssm.errors import InputError

__all__ = ["ANALYSES", "FORMAT", "Analysis"]

#: The questions to one fit, in the order in which they are answered and reported.
ANALYSES = ("forces", "kernels", "force_maps", "latents", "influence", "delays")
#: What comes with the answers.
FURTHER = ("edges", "scores", "parameters")
#: Stands at the root of a file of an analysis.
FORMAT = "swarmssm analysis 2"


@dataclass(frozen=True, repr=False)
class Analysis:
    """What a fitted model says of tracks; see :func:`swarmssm.analysis.interpretation.analyze`.

    Each dataset is ``None`` where it was not asked for or is not available for this model or these
    tracks; ``notes`` then say why. :meth:`verdict` is the result in one line, :meth:`summary` the
    main numbers, :meth:`to_pandas` the curves and tables behind the figures.

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
        ``isolated (individual)`` of :func:`swarmssm.analysis.find_leader` and
        :func:`swarmssm.analysis.find_isolated`, decided at the rate ``attrs["leader_rate"]``.
    delays
        Of :func:`swarmssm.analysis.leadership_delays`: who turns first, without any model.
    edges
        Of ``inferred_edges``, of a model that infers them.
    scores
        Forecast scores of held-out frames, of the fit, other fits and simple baselines.
    parameters
        ``mean``, ``sd``, ``low`` and ``high (parameter)`` of the parameters that have a prior, see
        :meth:`swarmssm.inference.Fit.summary`.
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
    delays: xr.Dataset | None = None
    edges: xr.Dataset | None = None
    scores: xr.Dataset | None = None
    parameters: xr.Dataset | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def datasets(self) -> dict[str, xr.Dataset]:
        """The datasets that are there, by name."""
        found = {name: getattr(self, name) for name in (*ANALYSES, *FURTHER)}
        return {name: dataset for name, dataset in found.items() if dataset is not None}

    def verdict(self) -> str:
        """Return what moves the animals, how sure that is, and whether it forecasts, in a line.

        Forces are to be believed if the model forecasts frames that it was not trained on better
        than the best simple baseline, see :mod:`swarmssm.analysis.interpretation.verdict`.
        """
        return verdict_of(self.datasets)

    def summary(self) -> pd.DataFrame:
        """Return the main numbers.

        Returns
        -------
        A row for each number, indexed by ``analysis`` and ``quantity``; columns ``value`` (the
        median over the posterior where there are draws), ``low`` and ``high`` (ends of the 90 %
        interval, NaN without one), ``unit``, and ``reference``, what the number is to be compared
        with.
        """
        return summary_of(self.datasets)

    def to_pandas(self) -> dict[str, pd.DataFrame]:
        """Return tidy tables of what the figures show, by name.

        ``forces``, ``forces_by_individual``, ``forces_over_time``, ``kernels`` (the curves),
        ``kernel_ranges``, ``modulation``, ``force_maps``, ``latents``, ``influence`` (pairs),
        ``leadership``, ``delays`` (pairs), ``delay_leads``, ``edges``, ``scores`` and
        ``parameters``; those of analyses that are there. ``low``, ``median`` and ``high`` are
        posterior quantiles (5, 50 and 95 %).
        """
        return tables_of(self.datasets)

    def __repr__(self) -> str:
        """Return what the analysis is of, and its verdict."""
        model = self.settings.get("model", "?")
        return f"<Analysis of {model}: {', '.join(self.datasets) or 'empty'}>\n{self.verdict()}"

    def _repr_html_(self) -> str:
        """Return verdict, main numbers and notes for a notebook."""
        table = pd.DataFrame(formatted_summary(self.datasets))
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self.notes)
        return (
            f"<p><strong>Analysis of {html.escape(str(self.settings.get('model', '?')))}.</strong> "
            f"{html.escape(self.verdict())}</p>{table.to_html(index=False)}<ul>{notes}</ul>"
        )

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
        attrs = {"format": FORMAT, "settings": self.settings, "notes": list(self.notes)}
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
        return cls(**groups, settings=dict(attrs["settings"]), notes=tuple(attrs["notes"]))
