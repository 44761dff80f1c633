"""What plants, estimators and controllers have in common."""

from __future__ import annotations

from collections.abc import Mapping

from rmpc_bench.types.attribute import attribute


class Design:
    """A frozen object that is made once, before any run, and shared by all runs and workers."""

    @attribute
    def remarks(self) -> tuple[str, ...]:
        """Sentences for the user about this design; `check` prints them."""
        return ()

    @attribute
    def cost_per_step(self) -> float:
        """Time of a step per run in a block of 50 runs [s]; 0 where it is a few microseconds at most."""
        return 0.0

    @attribute
    def expected_failures(self) -> Mapping[str, str]:
        """Checks of `rmpc_bench.conformance` that the component is meant to fail -> reason; reports print them."""
        return {}

    @attribute
    def holds(self) -> bool:
        """Whether a failed step of a run is held and counted, so that the run goes on."""
        return False

    def warm_up(self) -> None:
        """Do costly work that workers share, such as compiling; doing it again costs nothing."""
