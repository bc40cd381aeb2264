"""Effects of a scene: from the model of the file to what `simulate` applies."""

from phantomgen.effects import Effects, TubeOutput
from phantomgen.scene_yaml import SceneFile


def scene_effects(file: SceneFile) -> Effects:
    """The effects that a scene asks for.

    Raises
    ------
    SceneError
        Where an effect is impossible, or contradicts another part of the scene.
    """
    model = file.model.effects
    output = model.tube_output
    with file.at("effects", "tube_output"):
        tube_output = None if output is None else TubeOutput(output.sigma, output.recorded)
    return Effects(tube_output=tube_output)
