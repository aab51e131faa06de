from maglev_mj.scenes.find import find_scene as find_scene
from maglev_mj.scenes.names import BUILT_IN as BUILT_IN
from maglev_mj.scenes.names import scene_names as scene_names
from maglev_mj.scenes.scene import Scene as Scene
from maglev_mj.scenes.scene import Start as Start
