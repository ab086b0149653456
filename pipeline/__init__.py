"""spatialviz's headless core: RGB-D frames to grounded spatial relations.

Data flows one way: frame -> proposals -> lifted -> scored -> ranked.
Importing this package imports no deep-learning or graphics library.
"""

__version__ = "0.1.0"
