"""The public names and where each is defined; `__init__.py` imports them when they are used."""

from . import sweeps as sweeps
from .backbone import Backbone as Backbone
from .backbone import get_backbone as get_backbone
from .calibration import Calibration as Calibration
from .calibration import calibrate as calibrate
from .compiled.compiler_options import compiler_options as compiler_options
from .config import Config as Config
from .config import load_config as load_config
from .decision import Decisions as Decisions
from .decision import Outcome as Outcome
from .errors import RemindError as RemindError
from .frame import Detections as Detections
from .frame import Frame as Frame
from .method import Method as Method
from .method import get_method as get_method
from .method import list_methods as list_methods
from .method import register_method as register_method
from .metrics import compare as compare
from .metrics import evaluate as evaluate
from .observation import FrameFeats as FrameFeats
from .observation import Masks as Masks
from .outputs.overlay import draw as draw
from .outputs.result import Result as Result
from .session.live import Tracker as Tracker
from .session.run import run as run
from .sources import Sampling as Sampling
from .sources import open_source as open_source
from .static import Static as Static
from .sweeps import stack_scene as stack_scene
from .sweeps import sweep as sweep
from .tracks import Tracks as Tracks

__all__: list[str]
__version__: str
