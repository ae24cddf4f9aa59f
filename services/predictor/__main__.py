"""The predictor as a process: `python -m services.predictor --help`. The only process that loads torch."""

import sys
from dataclasses import dataclass, field

import tyro

from services.predictor.core import PredictorCore, PredictorSettings
from vantage.service import BusSettings, CannotStart, run


@dataclass(frozen=True)
class Settings:
    """The predictor: what will the seeker see, and will the hider be caught?"""

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    predictor: tyro.conf.OmitArgPrefixes[PredictorSettings] = field(default_factory=PredictorSettings)


def make_core(settings: PredictorSettings) -> PredictorCore:
    """Load the weights and compute one batch, so that the first request does not wait for it.

    Raises:
        CannotStart: torch is not installed, the weights cannot be used, or what they answer is not a number.
    """
    try:
        from vantage.networks.inference import Inference
        from vantage.networks.weights import UnusableWeights
    except ImportError as error:
        raise CannotStart(f"{error}: install the extra `learning` (pip install 'vantage-hide-and-seek[learning]')") from None
    try:
        networks = Inference.of_weights(settings.weights, settings.batch, settings.threads)
    except UnusableWeights as error:
        raise CannotStart(str(error)) from None
    core = PredictorCore(networks, settings)
    core.warm_up()
    if core.trouble:
        raise CannotStart(f"{settings.weights}: {core.trouble}")
    return core


def main(settings: Settings) -> int:
    return run(lambda: make_core(settings.predictor), "predictor", settings.bus)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
