"""Dynamic occupancy grids by particles: the PHD/MIB filter of Nuss et al. 2016; its equation numbers stand in the code.

"A random finite set approach for dynamic occupancy grid maps with real-time application" (Int. J. Robotics Research
2018).  Occupied mass is carried by particles with a velocity, free mass by the cells.  All steps are array operations
on any device; each stage has a file of its own.
"""

from envpred.mapping.particles.filter import DogmaGrid, step

__all__ = ["DogmaGrid", "step"]
