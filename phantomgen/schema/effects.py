"""Effects of a real scan in a scene file; each is off where its key is left out."""

from typing import Annotated

from pydantic import Field

from phantomgen.schema.base import Model, NonNegative


class TubeOutputModel(Model):
    """Output of the tube that varies between exposures: relative standard deviation; `recorded` in the file, or not."""

    sigma: Annotated[NonNegative, Field(le=0.2)]
    recorded: bool = True


class EffectsModel(Model):
    """What a real scan has beyond exposure and photon noise."""

    tube_output: TubeOutputModel | None = None
