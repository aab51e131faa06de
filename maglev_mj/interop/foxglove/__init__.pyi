from maglev_mj.interop.foxglove.server import PORT as PORT
from maglev_mj.interop.foxglove.server import LiveServer as LiveServer
from maglev_mj.interop.foxglove.server import LiveServerError as LiveServerError
