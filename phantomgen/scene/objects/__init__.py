"""From object entries to shapes with materials: members, copies, voxel maps, added overlaps."""
