"""The law of motion that a fit found, as values to hold while something else is learned."""

from typing import Any

from swarmssm.errors import InputError
from swarmssm.inference.fitted import Fit
from swarmssm.models import StateSpaceModel
from swarmssm.models.parameters import priors_of

__all__ = ["fixed_transition"]

#: Draws of which the middle is taken.
DRAWS = 1000


def fixed_transition(law: Fit) -> dict[str, Any]:
    """Return what a fit found of its law of motion, as priors that hold it there.

    Who acts on whom and by which law cannot well be learned at once: under random edges every
    force looks weak, and under weak forces all edges look alike. So first fit a law on a graph that
    may do for the time being, then hold it and learn the edges::

        law = fit("boids", tracks=tracks, graph="radius:3")
        fit("boids", tracks=tracks, edges="dynamic-relational", priors=held_law(law))

    Parameters
    ----------
    law
        Of a state-space model, all learned parameters of which have a prior.

    Returns
    -------
    Full name -> posterior median, a number or nested list, as
    :func:`swarmssm.models.with_priors` takes it.

    Raises
    ------
    InputError
        If it is no state-space model, or has learned parameters without a prior, as networks do.
    """
    model, name = law.model, law.settings.model
    if not isinstance(model, StateSpaceModel):
        raise InputError(f"law: {name} is no state-space model, and has no law to hold.")
    free = [
        place
        for place, value in model.named_parameters()
        if value.requires_grad and not place.startswith("edges.")
    ]
    if free:
        shown = ", ".join(free[:3]) + (", ..." if len(free) > 3 else "")
        raise InputError(
            f"law: {name} has learned parameters without a prior ({shown}), which are not held. "
            "Take a model of named forces such as boids, linear or kernel."
        )
    drawn = law.parameters(DRAWS, seed=0)
    return {
        site: drawn[site].median("draw").to_numpy().tolist()
        for site in priors_of(model)
        if not site.startswith("edges.")
    }
