from .app import Limits as Limits
from .listening import serve as serve
from .log import Log as Log
