"""How a pixel's average is taken, in order of growing effort.

=========  ================================================  =======================================================
class      where                                             rule
=========  ================================================  =======================================================
`EMPTY`    no shape projects near the pixel                  the counts of a ray without attenuation
`SMOOTH`   away from silhouettes                             centre, and second differences over the four neighbours
`NEAR`     up to a few pixels inside a tangent, or beside a  Gauss nodes in the tangent's own variable
           pixel that is crossed, or on the panel's border
`CROSSED`  a silhouette passes                               split along it, Gauss nodes on each side; where surfaces
                                                             intersect as well, more of these, or as `INTERSECTED`
`INTERSECTED`   the order of surfaces along the ray changes       rectangles, halved until their errors are small
           though no silhouette passes: two of them
           intersect there, or an edge of a mesh passes
`VOXELS`   a voxel map projects there                        small regular grid of rays, unless one of the two above
=========  ================================================  =======================================================
"""

EMPTY = 0
SMOOTH = 1
NEAR = 2
CROSSED = 3
INTERSECTED = 4
VOXELS = 5
CLASSES = 6
