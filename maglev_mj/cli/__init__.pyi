from maglev_mj.cli.program import main as main
from maglev_mj.cli.program import parse as parse
