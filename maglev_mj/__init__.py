"""Virtual magnetically levitated haptic joystick: simulation, sampled laws, real devices.

A table of contents; `help(maglev_mj.NAME)` tells more. Every name is loaded on first use.

Laws, rendered by the controller:

    AxisLaw                  base of a law that acts on each axis by itself
    Law                      base of any law
    gain                     declares a gain of an `AxisLaw`
    check_law                tries a law alone and in a batch
    Wall                     spring and damper, with a braking pulse on entry
    PredictiveWall           wall that renders its mean force over the next period
    ObserverWall             wall with the delay as states of an observer
    Hold                     PD control of pose
    Bias                     constant wrench, such as the weight
    StickSlip                friction by the paper's Karnopp law
    ImplicitCoulomb          friction without chatter at any rate
    FiniteDifference         velocity estimate by plain differences
    LowPass                  velocity estimate by a first-order filter

Control loop:

    Controller               sum of laws, evaluated once a sample
    drive                    runs controller and plant for a number of samples
    Timing                   period, delay and phase of the samples
    Sample                   pose, velocity and time handed to the controller
    Command                  wrench and pulse handed to the plant
    AXES                     names of the six axes

Plants and the hand on them:

    ExactPlant               closed-form motion, for one device or N
    MuJoCoPlant              the whole device in MuJoCo
    Sensor                   sensor with a resolution and noise
    SpotSensor               the device's sensor: three beams on three diodes
    CoilMap                  currents to wrench, and back
    load_model               compiles a model of the device
    model_path               MJCF file of a model
    Hand                     mass, damping and stiffness of a hand
    HANDS                    published hands, by name
    SpringHand               hand that pulls to a pose moved at any time
    Trajectory               minimum-jerk movements between poses

Scenes:

    Scene                    base of a scene: subclass it
    Start                    state at release
    param                    declares a parameter of a scene
    Turn                     step of a parameter's key
    hold                     well-damped hold of the other axes
    figure                   makes a function of a result a figure
    find_scene               class of a scene, by name or file
    run                      runs a scene to its end
    run_phases               runs a scene at many sampling phases
    RunResult                motion and figures of one run
    Phases                   figures over the phases
    Session                  a scene in real time
    real_time                paces a session
    LiveServer               serves a session to other programs

Stability and design:

    stability                verdict on a scene
    judge                    verdict on a controller
    linearise                linear model of a controller, to `python-control` too
    largest_stable_stiffness stiffest wall, by period, delay, mass and hand
    critical_delay           delay at which a wall becomes unstable
    design_wall              gains that bear a range of loops
    WallRequirements         such a range, and a margin

Studies:

    sweep                    runs a scene over a grid of parameters
    run_cells                runs a function of your own over a grid
    local_workers            processes of this machine
    dask_workers             workers of a Dask cluster
    measure_fidelity         cheapest model and step within a tolerance
    Range                    cases for which that must hold

Recordings:

    record_run               runs a scene into a recording in memory
    write_run                runs a scene into a file
    open_recording           file that a loop of your own records to
    Recording                a recording, read or in memory
    load_samples             its samples as arrays or a data frame
    export                   writes CSV, `.npz` or Parquet
    rebuild                  makes controller and plant of a recording again
    verify                   runs a recording again and compares every bit
    analyse                  walls, energy and friction in a recording
    identify                 parameters from a recording, with errors

A device, or its twin:

    RemotePlant              a device as a plant
    open_link                link to an address, UDP or serial
    HostLimits               limits that the host keeps
    Calibration              coils, beams and body of a device
    Twin                     simulated device behind the same protocol
    TwinParameters           its parameters
    estop                    cuts the currents of a device
    conform                  tests a device against the protocol
    AxisMapping              settings of a six-axis input device

Errors:

    MaglevError              base of all errors
    ParameterError           a value that is not allowed; also a ValueError
    PlantError               a plant that cannot go on
    DivergenceError          a simulation that diverges

Packages such as `maglev_mj.laws` and `maglev_mj.theory` have further names.
"""

from maglev_mj.lazy import attach

TYPE_CHECKING = False  # as in typing, which a program need not wait for
if TYPE_CHECKING:
    from maglev_mj.analysis import analyse as analyse
    from maglev_mj.analysis import identify as identify
    from maglev_mj.bridge import Calibration as Calibration
    from maglev_mj.bridge import HostLimits as HostLimits
    from maglev_mj.bridge import RemotePlant as RemotePlant
    from maglev_mj.bridge import Twin as Twin
    from maglev_mj.bridge import TwinParameters as TwinParameters
    from maglev_mj.bridge import open_link as open_link
    from maglev_mj.bridge.connection import estop as estop
    from maglev_mj.coils import CoilMap as CoilMap
    from maglev_mj.conformance import conform as conform
    from maglev_mj.controller import Controller as Controller
    from maglev_mj.errors import DivergenceError as DivergenceError
    from maglev_mj.errors import MaglevError as MaglevError
    from maglev_mj.errors import ParameterError as ParameterError
    from maglev_mj.errors import PlantError as PlantError
    from maglev_mj.frames import AXES as AXES
    from maglev_mj.frames import Command as Command
    from maglev_mj.frames import Sample as Sample
    from maglev_mj.hand import HANDS as HANDS
    from maglev_mj.hand import Hand as Hand
    from maglev_mj.hand import SpringHand as SpringHand
    from maglev_mj.hand import Trajectory as Trajectory
    from maglev_mj.laws import AxisLaw as AxisLaw
    from maglev_mj.laws import Bias as Bias
    from maglev_mj.laws import FiniteDifference as FiniteDifference
    from maglev_mj.laws import Hold as Hold
    from maglev_mj.laws import ImplicitCoulomb as ImplicitCoulomb
    from maglev_mj.laws import Law as Law
    from maglev_mj.laws import LowPass as LowPass
    from maglev_mj.laws import ObserverWall as ObserverWall
    from maglev_mj.laws import PredictiveWall as PredictiveWall
    from maglev_mj.laws import StickSlip as StickSlip
    from maglev_mj.laws import Wall as Wall
    from maglev_mj.laws import check_law as check_law
    from maglev_mj.laws import gain as gain
    from maglev_mj.live import LiveServer as LiveServer
    from maglev_mj.loop import drive as drive
    from maglev_mj.model import load_model as load_model
    from maglev_mj.model import model_path as model_path
    from maglev_mj.parameters import Turn as Turn
    from maglev_mj.parameters import param as param
    from maglev_mj.plants import ExactPlant as ExactPlant
    from maglev_mj.plants import MuJoCoPlant as MuJoCoPlant
    from maglev_mj.plants import Sensor as Sensor
    from maglev_mj.plants import SpotSensor as SpotSensor
    from maglev_mj.plants import Timing as Timing
    from maglev_mj.recording import Recording as Recording
    from maglev_mj.recording import load_samples as load_samples
    from maglev_mj.recording import open_recording as open_recording
    from maglev_mj.recording.export import export as export
    from maglev_mj.recording.verify import verify as verify
    from maglev_mj.scenes.figures import figure as figure
    from maglev_mj.scenes.find import find_scene as find_scene
    from maglev_mj.scenes.parts import hold as hold
    from maglev_mj.scenes.run import Phases as Phases
    from maglev_mj.scenes.run import RunResult as RunResult
    from maglev_mj.scenes.run import run as run
    from maglev_mj.scenes.run import run_phases as run_phases
    from maglev_mj.scenes.scene import Scene as Scene
    from maglev_mj.scenes.scene import Start as Start
    from maglev_mj.session import Session as Session
    from maglev_mj.session import real_time as real_time
    from maglev_mj.session.replay import rebuild as rebuild
    from maglev_mj.session.replay import record_run as record_run
    from maglev_mj.session.replay import write_run as write_run
    from maglev_mj.spacenav import AxisMapping as AxisMapping
    from maglev_mj.studies.cells import dask_workers as dask_workers
    from maglev_mj.studies.cells import local_workers as local_workers
    from maglev_mj.studies.cells import run_cells as run_cells
    from maglev_mj.studies.fidelity import Range as Range
    from maglev_mj.studies.fidelity import measure_fidelity as measure_fidelity
    from maglev_mj.studies.sweep import sweep as sweep
    from maglev_mj.theory import WallRequirements as WallRequirements
    from maglev_mj.theory import critical_delay as critical_delay
    from maglev_mj.theory import design_wall as design_wall
    from maglev_mj.theory import largest_stable_stiffness as largest_stable_stiffness
    from maglev_mj.theory.linearise import linearise as linearise
    from maglev_mj.theory.verdict import judge as judge
    from maglev_mj.theory.verdict import stability as stability
else:
    _HOMES = {
        "analysis": "analyse identify",
        "bridge": "Calibration HostLimits RemotePlant Twin TwinParameters open_link",
        "bridge.connection": "estop",
        "coils": "CoilMap",
        "conformance": "conform",
        "controller": "Controller",
        "errors": "DivergenceError MaglevError ParameterError PlantError",
        "frames": "AXES Command Sample",
        "hand": "HANDS Hand SpringHand Trajectory",
        "laws": "AxisLaw Bias FiniteDifference Hold ImplicitCoulomb Law LowPass ObserverWall PredictiveWall"
        " StickSlip Wall check_law gain",
        "live": "LiveServer",
        "loop": "drive",
        "model": "load_model model_path",
        "parameters": "Turn param",
        "plants": "ExactPlant MuJoCoPlant Sensor SpotSensor Timing",
        "recording": "Recording load_samples open_recording",
        "recording.export": "export",
        "recording.verify": "verify",
        "session.replay": "rebuild record_run write_run",
        "scenes.parts": "hold",
        "scenes.figures": "figure",
        "scenes.find": "find_scene",
        "scenes.run": "Phases RunResult run run_phases",
        "scenes.scene": "Scene Start",
        "session": "Session real_time",
        "spacenav": "AxisMapping",
        "studies.cells": "dask_workers local_workers run_cells",
        "studies.fidelity": "Range measure_fidelity",
        "studies.sweep": "sweep",
        "theory": "WallRequirements critical_delay design_wall judge largest_stable_stiffness linearise stability",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)

__version__ = "0.2.0"
