from maglev_mj.live.server import PORT as PORT
from maglev_mj.live.server import LiveServer as LiveServer
from maglev_mj.live.server import LiveServerError as LiveServerError
