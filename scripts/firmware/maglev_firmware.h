/* Device side of docs/reference/protocol.md, version 5, in freestanding C99: no heap, no library, no clock.

   A board fills in a profile and a hardware structure, then calls maglev_receive() for each received frame and
   maglev_sample() once per sample period. README.md specifies the interrupts, and the function and time limit of each
   hardware callback. The functions below must not interrupt each other. */
#ifndef MAGLEV_FIRMWARE_H
#define MAGLEV_FIRMWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    MAGLEV_VERSION = 5,
    MAGLEV_COILS = 6,
    MAGLEV_SPOTS = 6,     /* x and y on diodes 0, 1 and 2 */
    MAGLEV_STOP = 8,      /* controlled stop at ARM: damping by spots, six [s/m], duration [s], lift */
    MAGLEV_HASH = 16,     /* bytes of a calibration digest */
    MAGLEV_KEY = 32,      /* largest key [bytes] */
    MAGLEV_WALLS = 12,    /* walls in a CMD: the faces of a box in six axes */
    MAGLEV_LARGEST = 600, /* largest frame [bytes]: a CMD with all walls and a tag has 584 */
    MAGLEV_STUFFED = MAGLEV_LARGEST + 5 /* largest frame on a serial link [bytes] */
};

enum maglev_type {
    MAGLEV_HELLO = 1, MAGLEV_HELLO_ACK, MAGLEV_CTRL, MAGLEV_CTRL_ACK, MAGLEV_STATE, MAGLEV_CMD, MAGLEV_ESTOP,
    MAGLEV_ESTOP_ACK, MAGLEV_TYPES
};
enum maglev_state { MAGLEV_INACTIVE, MAGLEV_ACTIVE, MAGLEV_FAULT };
enum maglev_operation { MAGLEV_ARM = 1, MAGLEV_DISARM, MAGLEV_RESET = 4, MAGLEV_TRIP, MAGLEV_BYE };
enum maglev_status { MAGLEV_WELCOME, MAGLEV_OTHER_VERSION, MAGLEV_BUSY, MAGLEV_OTHER_CALIBRATION };
enum maglev_result { MAGLEV_DONE, MAGLEV_REFUSED };
enum maglev_flag {
    /* flags, by make protocol */
    MAGLEV_HOLDING = 1,
    MAGLEV_ENABLED = 2,
    MAGLEV_STOPPING = 4,
    /* end */
};
enum maglev_fault {
    /* faults, by make protocol */
    MAGLEV_SENSOR_OUT_OF_RANGE = 1,
    MAGLEV_COIL_OVERTEMP = 2,
    MAGLEV_COIL_OVERCURRENT = 4,
    MAGLEV_FLOTOR_OVERSPEED = 8,
    MAGLEV_BOUNDARY = 16,
    MAGLEV_WATCHDOG = 32,
    MAGLEV_INVALID_COMMAND = 64,
    MAGLEV_ESTOPPED = 128,
    MAGLEV_COIL_NOT_FOLLOWING = 256,
    MAGLEV_SENSOR_FROZEN = 512,
    MAGLEV_CLOCK = 1024,
    MAGLEV_NOT_FOLLOWING = 2048,
    MAGLEV_HOST = 4096,
    MAGLEV_SENSOR_STOPPED = 8192,
    MAGLEV_COIL_NOT_OFF = 16384,
    MAGLEV_WALL_ENERGY = 32768,
    MAGLEV_ALL_FAULTS = 65535
    /* end */
};
/* Reasons for ignoring a frame: the first seven invalid, the others not acceptable. */
enum maglev_reason {
    MAGLEV_SHORT, MAGLEV_BAD_MAGIC, MAGLEV_BAD_CRC, MAGLEV_BAD_VERSION, MAGLEV_BAD_TYPE, MAGLEV_BAD_LENGTH,
    MAGLEV_BAD_TAG, MAGLEV_DIRECTION, MAGLEV_SESSION, MAGLEV_OLD, MAGLEV_NOT_ACTIVE, MAGLEV_BUSY_HELLO, MAGLEV_REASONS
};
extern const char *const maglev_reasons[MAGLEV_REASONS];

#define MAGLEV_NONE 0xFFFFFFFFu

/* Properties of a device. */
struct maglev_profile {
    /* properties, by make protocol */
    uint8_t lockstep;            /* 1 if simulated time waits for each answer */
    uint32_t device;             /* device number */
    uint8_t calibration[16];     /* digest that the device requires */
    uint64_t period;             /* between samples [ns] */
    uint64_t delay;              /* from a command's arrival to its effect [ns] */
    uint64_t latency;            /* age of the spots at the time of their sample [ns] */
    uint64_t watchdog;           /* longest time without a command [ns] */
    uint64_t enable;             /* longest time without a change of the enable line before the amplifier board opens
                                    [ns] */
    uint64_t stale;              /* largest age of a sample whose answer is accepted [ns] */
    uint32_t frozen;             /* number of equal consecutive readings that the sensor's noise rules out; 0: no noise,
                                    readings may repeat */
    double current_limit;        /* largest current in any coil [A] */
    double continuous_current;   /* continuous current rating of a coil [A] */
    double hover_limit;          /* largest hover current in any coil at ARM [A] */
    double thermal_time;         /* thermal time constant of a coil [s] */
    double spot_limit;           /* largest coordinate of a spot on its diode [m] */
    double spot_speed;           /* largest speed of a spot, for each coordinate [m/s] */
    uint64_t wall_period;        /* between samples of walls [ns]; 0 if the device renders none */
    uint64_t wall_delay;         /* from such a sample to its effect [ns] */
    double stiffness_limit;      /* largest stiffness of a wall [N/m] */
    double damping_limit;        /* largest damping of a wall [N s/m] */
    double edge_speed;           /* largest speed of a wall's edge [m/s] */
    uint32_t wall_count;         /* largest number of walls in a CMD, at most 12 */
    double lever;                /* lever arm of the limits of a wall on a rotation [m]: squared for gains, inverse for
                                    the edge's speed */
    double energy;               /* energy that the walls may return beyond what they took [J] */
    double recede;               /* speed at which the walls' edges recede in a controlled stop [m/s] */
    double off_current;          /* largest measured current of a coil that counts as off [A] */
    /* end */
    double spots[MAGLEV_SPOTS];  /* at the centre [m]; with the two maps below from the calibration, for walls */
    double pose[36];             /* row-major, pose per change of the spots [1, rad/m] */
    double current[36];          /* row-major, current per wrench [A/N, A/(N m)] */
    uint32_t key_length;         /* 16 to 32 bytes, or 0 for no key */
    uint8_t key[MAGLEV_KEY];
};

/* Measurements at a sample. */
struct maglev_reading {
    uint64_t time;                    /* of the sample [ns], whole periods after any other */
    double spots[MAGLEV_SPOTS];       /* [m] */
    double measured[MAGLEV_COILS];    /* currents [A] */
    double commanded[MAGLEV_COILS];   /* currents commanded at that time [A] */
    uint32_t number;                  /* of the sample; missed samples are counted */
    uint32_t conversions;             /* counted by the converter, not by software: see README.md */
    uint8_t valid;                    /* bit k: spot of diode k is valid */
    bool enabled;                     /* read back: the board sees the enable line toggle */
};

/* Functions of a board. `context` is the first argument of every call. No function blocks. */
struct maglev_hardware {
    void *context;
    void (*read)(void *context, struct maglev_reading *reading);
    /* Currents [A] from `delay` after `now` on: `pulsed` for the first `width` seconds, then `held`. */
    void (*drive)(void *context, uint64_t now, const double *held, const double *pulsed, double width);
    /* Add the currents of walls [A] to the others from `wall_delay` after `now` on, until the next call. May be null
       without walls. */
    void (*add)(void *context, uint64_t now, const double *currents);
    /* Switch all currents off immediately, those of walls too, and discard pending commands. */
    void (*cut)(void *context);
    /* Toggle the enable line. */
    void (*toggle)(void *context, uint64_t now);
    /* Device clock [ns]; never decreases. */
    uint64_t (*now)(void *context);
    /* 32 unpredictable bits. */
    uint32_t (*random)(void *context);
};

/* A wall rendered at the device's own rate; cutoff 0: no filter. */
struct maglev_wall {
    /* walls, by make protocol */
    uint8_t axis;
    int8_t side;
    double edge;
    double stiffness;
    double damping;
    double cutoff;
    /* end */
};

struct maglev_frame {
    uint8_t type;
    uint32_t session, sequence;
    uint64_t time;
    union {
        struct {
            /* HELLO, by make protocol */
            uint64_t nonce;
            uint8_t calibration[16];
            /* end */
        } hello;
        struct {
            /* HELLO_ACK, by make protocol */
            uint64_t nonce;
            uint8_t status;
            uint8_t lockstep;
            uint8_t version;
            uint8_t state;
            uint32_t device;
            uint8_t calibration[16];
            uint64_t period;
            uint64_t delay;
            uint64_t latency;
            uint64_t watchdog;
            uint64_t enable;
            uint64_t stale;
            uint64_t fault_time;
            uint32_t faults;
            uint32_t first;
            uint32_t frozen;
            double current_limit;
            double continuous_current;
            double hover_limit;
            double thermal_time;
            double spot_limit;
            double spot_speed;
            uint64_t wall_period;
            uint64_t wall_delay;
            double stiffness_limit;
            double damping_limit;
            double edge_speed;
            uint32_t wall_count;
            double lever;
            double energy;
            double recede;
            double off_current;
            /* end */
        } hello_ack;
        struct {
            /* CTRL, by make protocol */
            uint32_t request;
            uint8_t operation;
            uint32_t faults;
            double hover[6];
            double stop[8];
            /* end */
        } ctrl;
        struct {
            /* CTRL_ACK, by make protocol */
            uint32_t request;
            uint8_t operation;
            uint8_t result;
            uint8_t state;
            uint32_t faults;
            /* end */
        } ctrl_ack;
        struct {
            /* STATE, by make protocol */
            double spots[6];
            float currents[6];
            float temperatures[6];
            uint8_t state;
            uint8_t valid;
            uint16_t flags;
            uint32_t faults;
            uint32_t answered;
            uint32_t age;
            uint32_t conversions;
            /* end */
        } state;
        struct {
            /* CMD, by make protocol */
            uint32_t answers;
            uint32_t flags;
            double held[6];
            double pulsed[6];
            double width;
            /* end */
            uint32_t count;      /* of the walls; on the wire the length of the frame */
            struct maglev_wall walls[MAGLEV_WALLS];
        } cmd;
        struct {
            /* ESTOP, by make protocol */
            uint64_t request;
            /* end */
        } estop;
        struct {
            /* ESTOP_ACK, by make protocol */
            uint64_t request;
            uint8_t state;
            uint8_t lockstep;
            uint32_t faults;
            uint64_t sampled;
            float currents[6];
            double off_current;
            /* end */
        } estop_ack;
    } of;
};

/* Last valid spots [m] at a sample, and equal readings of each diode in a row. */
struct maglev_diodes { double spots[MAGLEV_SPOTS]; uint32_t number, same[3]; bool known; };

/* A device: one session at a time, a state, latched faults. The fields up to `rises` may be read by others; only the
   functions below write them. */
struct maglev_device {
    const struct maglev_profile *profile;
    const struct maglev_hardware *hardware;
    uint64_t peer;                     /* address for STATEs during a session */
    uint64_t fault_time;               /* time of the first latched fault [ns]; 0 for none */
    uint32_t session;                  /* session number; 0 for none */
    uint32_t faults, first;            /* latched faults; those latched by the first trip */
    uint32_t answered;                 /* sample of the newest accepted answer, if `is_answered` */
    uint32_t counts[MAGLEV_REASONS];   /* ignored frames, by reason */
    uint8_t state;
    bool is_answered, holding;
    bool stopping;                     /* a controlled stop: currents flow in FAULT */
    bool walled;                       /* maglev_wall() is to be called */
    double rises[MAGLEV_COILS];        /* temperatures; a coil trips at 1 */

    /* the session */
    uint64_t nonce, heard;
    uint32_t sequence;
    struct { uint32_t request; uint8_t operation, result; bool any; } last;
    /* the flight */
    double hover[MAGLEV_COILS], stop[MAGLEV_STOP];
    uint64_t commanded_at;
    uint32_t answers;
    /* the sensors */
    double measured[MAGLEV_COILS];
    struct maglev_diodes diodes;
    uint64_t sampled;
    uint32_t number, conversions;
    uint8_t not_following, not_off, not_enabled;
    bool has_conversions, has_sampled, heated;
    /* the walls: in effect, and of the newest CMD from `due` on; the rest is that of the last wall sample */
    struct maglev_wall walls[MAGLEV_WALLS], next[MAGLEV_WALLS];
    uint32_t count, next_count;
    bool has_next, has_pose;
    uint64_t due, wall_sampled;
    double pose[6], wall_speeds[MAGLEV_WALLS], wall_forces[MAGLEV_WALLS], peaks[2][MAGLEV_COILS], energy, stored;
    struct maglev_diodes seen;
    double wall_currents[MAGLEV_COILS]; /* of the last sample of the walls */
    uint32_t receding;                  /* samples of the walls in a controlled stop */
    uint32_t stopped;                   /* number of the last sample when a controlled stop began */
    uint32_t newest;                    /* newest sample answered since ARM: edges move with it */
};

/* Start inactive, with the currents cut. Return false, without effect, if the profile is invalid: a time or limit not
   above 0, not finite, or inconsistent with another (see HELLO_ACK in the protocol), a wrong key length, or a missing
   function. Profile and hardware are kept by reference. */
bool maglev_start(struct maglev_device *device, const struct maglev_profile *profile,
                  const struct maglev_hardware *hardware);

/* Process a received frame and write the answer for its peer, at most MAGLEV_LARGEST bytes. Return its length; 0 for
   none. A peer is any number that represents an address; constant on a serial link. */
size_t maglev_receive(struct maglev_device *device, const uint8_t *data, size_t length, uint64_t peer,
                      uint8_t *answer);

/* Read a sample, react to faults, and write the STATE for the session's peer. Return its length, 0 without a
   session. */
size_t maglev_sample(struct maglev_device *device, uint8_t *frame);

/* While `device->walled`, call once per wall period, at a period's own sample after maglev_sample(): render the walls. */
void maglev_wall(struct maglev_device *device);

/* Update the temperatures for constant currents [A] over a duration [s]. A board with pulses calls it for each interval
   since the last sample; if it is not called, maglev_sample() assumes the measured currents for the whole period. */
void maglev_heat(struct maglev_device *device, double seconds, const double *currents);

/* Cut the currents and latch faults for a reason detected by the board, such as its emergency stop. */
void maglev_trip(struct maglev_device *device, uint32_t faults);

/* Lockstep: the host is lost. Latch WATCHDOG if currents flow, cut them, and end the session. */
void maglev_lose_host(struct maglev_device *device);

/* Write a frame, with a tag if the profile has a key; return its length. */
size_t maglev_encode(const struct maglev_profile *profile, struct maglev_frame *frame, uint8_t *data);

/* Decode a frame; return MAGLEV_REASONS if it is valid, else the reason. */
enum maglev_reason maglev_decode(const struct maglev_profile *profile, const uint8_t *data, size_t length,
                                 struct maglev_frame *frame);

/* COBS-encode a frame of at most MAGLEV_LARGEST bytes, with a zero byte before and after; return the length, at most
   MAGLEV_STUFFED. */
size_t maglev_stuff(const uint8_t *frame, size_t length, uint8_t *out);

/* Decoder of a serial link; initialise with zeros. */
struct maglev_line { uint8_t data[MAGLEV_LARGEST]; uint16_t length; uint8_t code, left; bool lost; };

/* Process the next byte; return the length of the frame that it completed, in `line->data` until the next byte, or 0.
   Invalid frames are skipped. */
size_t maglev_unstuff(struct maglev_line *line, uint8_t byte);

#endif
