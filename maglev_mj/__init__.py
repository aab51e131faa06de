"""Virtual magnetically levitated haptic joystick: simulation, sampled laws, real devices.

Contents by topic; see `help(maglev_mj.NAME)`. Names are imported on first use.

Laws, rendered by the controller:

    AxisLaw                  base of laws that act on each axis separately
    CLaw                     base of laws that are a function in C, such as the firmware's
    Law                      base of any law
    gain                     declares a gain of an `AxisLaw`
    check_law                checks a law on one device and in a batch
    Wall                     PD wall, with a braking pulse on entry
    HalfSampleWall           wall with half-sample prediction
    VirtualCoupling          wall that stops a virtual mass coupled to the flotor
    Hold                     PD control of the pose
    Bias                     constant wrench, e.g. weight compensation
    StickSlip                stick-slip friction by the paper's Karnopp law
    ImplicitCoulomb          friction without chatter at any rate
    FiniteDifference         velocity estimate by finite differences
    LowPass                  velocity estimate by a first-order filter

Control loop:

    Controller               sum of laws, evaluated once per sample
    drive                    runs a controller on a plant for a number of samples
    Timing                   sample period, delay and sampling phase
    Sample                   measured pose and time, input of the controller
    Command                  wrench, pulse and walls, output of the controller
    DeviceWall               wall that the device renders at its own rate
    AXES                     names of the six axes

Plants and the hand on them:

    ExactPlant               closed-form motion, for one device or a batch
    MuJoCoPlant              full device model in MuJoCo
    Sensor                   sensor with a resolution and noise
    SpotSensor               the device's sensor: three beams on three diodes
    CoilMap                  conversion of currents to wrench and back
    load_model               compiles a model of the device
    model_path               MJCF file of a model
    Hand                     mass, damping and stiffness of a hand
    HANDS                    published hands, by name
    SpringHand               hand with a spring to a movable target pose
    Trajectory               path through timed poses: minimum-jerk, linear or cubic

Scenes:

    Scene                    base of a scene: subclass it
    Start                    initial state
    param                    declares a parameter of a scene
    Turn                     change of a parameter by a key press
    hold                     well-damped hold of the remaining axes
    figure                   declares a function of a result as a figure
    find_scene               class of a scene, by name or file
    run                      runs a scene to its end
    run_phases               runs a scene at many sampling phases
    RunResult                motion and figures of one run
    Phases                   figures over the sampling phases
    Session                  scene in real time
    real_time                runs a session at real-time pace

Stability and design:

    stability                stability of a scene
    judge                    stability of a controller
    linearise                linear model of a controller, also for `python-control`
    largest_stable_stiffness critical stiffness by period, delay, mass and hand
    critical_delay           critical delay of a wall
    design_wall              gains for a range of masses, delays and hands
    WallRequirements         that range, and a margin

Studies:

    sweep                    runs a scene over a grid of parameters
    compare                  comparison of wall laws in one scene
    diagnose                 why a wall shakes, and the change that helps most
    device_card              impedances, masses and forces that a device can render
    run_cells                runs your own function over a grid
    local_workers            worker processes on this machine
    dask_workers             workers of a Dask cluster
    measure_fidelity         cheapest model and integrator step within a tolerance
    Range                    range of validity for that

Recordings:

    record_run               runs a scene into a recording in memory
    write_run                runs a scene into a file
    open_recording           recording file for your own control loop
    Recording                recording, loaded or in memory
    load_samples             its samples as arrays or a data frame
    export                   writes MCAP, CSV, `.npz`, Parquet or WAV
    rebuild                  rebuilds controller and plant of a recording
    verify                   re-runs a recording and compares bit for bit
    analyse                  analyses walls, energy and friction of a recording
    identify                 estimates parameters from a recording, with standard errors

A device, or its twin:

    RemotePlant              device as a plant
    open_link                link to an address, UDP or serial
    HostLimits               limits enforced by the host
    Device                   description of a device, read from a file
    Calibration              coils, beams, mass and inertia of a device
    Twin                     simulated device behind the same protocol
    TwinParameters           its parameters
    estop                    emergency stop of a device
    conform                  protocol conformance test of a device
    AxisMapping              axis mapping of a six-axis input device

Errors:

    MaglevError              base class of all errors
    ParameterError           invalid value; also a ValueError
    PlantError               plant that cannot continue
    DivergenceError          diverged simulation

Subpackages such as `maglev_mj.control` and `maglev_mj.theory` have more names.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

__version__ = "0.3.0"
