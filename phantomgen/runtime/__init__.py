"""The machine and the moment: time, memory, versions, disk space, thumbnails for notebooks."""
