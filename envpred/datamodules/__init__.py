"""Windows over a store of grids: the input variants as views, and the LightningDataModule that serves them."""

from envpred.datamodules.grids import GridDataModule
from envpred.datamodules.windows import Window, WindowBatch

__all__ = ["GridDataModule", "Window", "WindowBatch"]
