"""Bodies built of solids: a torso and a head, as plain objects and materials of a scene."""
