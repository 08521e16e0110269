"""Windows over a store of grids: the input variants as views, and the LightningDataModule that serves them."""

from envpred.datamodules.contract import Forecast, Future, Needs, Role, Seen, WindowBatch
from envpred.datamodules.grids import GridDataModule
from envpred.datamodules.variants import Variant
from envpred.datamodules.windows import Window

__all__ = [
    "Forecast",
    "Future",
    "GridDataModule",
    "Needs",
    "Role",
    "Seen",
    "Variant",
    "Window",
    "WindowBatch",
]
