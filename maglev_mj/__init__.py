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
    compare                  laws of a wall side by side in one scene
    device_card              impedances, masses and forces that a device renders
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
    export                   writes MCAP, CSV, `.npz`, Parquet or WAV
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

Packages such as `maglev_mj.control` and `maglev_mj.theory` have further names.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

__version__ = "0.2.0"
