/* The device's side of docs/reference/protocol.md, version 3, in freestanding C99: no heap, no library, no clock of its own.

   A board fills in a profile and a hardware structure, then calls maglev_receive() for each frame that came and
   maglev_sample() once in every sample period; README.md beside this file says from which interrupt, and what each of
   the hardware's functions must do, and by when. None of the functions below may interrupt another of them. */
#ifndef MAGLEV_FIRMWARE_H
#define MAGLEV_FIRMWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    MAGLEV_VERSION = 3,
    MAGLEV_COILS = 6,
    MAGLEV_SPOTS = 6,     /* x and y on the first diode, on the second, on the third */
    MAGLEV_HASH = 16,     /* bytes of a calibration's hash */
    MAGLEV_KEY = 32,      /* most bytes of a key */
    MAGLEV_LARGEST = 256, /* bytes; what is longer is no frame */
    MAGLEV_STUFFED = MAGLEV_LARGEST + 4 /* bytes that a frame may take on a serial line */
};

enum maglev_type {
    MAGLEV_HELLO = 1, MAGLEV_HELLO_ACK, MAGLEV_CTRL, MAGLEV_CTRL_ACK, MAGLEV_STATE, MAGLEV_CMD, MAGLEV_ESTOP,
    MAGLEV_ESTOP_ACK, MAGLEV_TYPES
};
enum maglev_state { MAGLEV_INACTIVE, MAGLEV_ACTIVE, MAGLEV_FAULT };
enum maglev_operation { MAGLEV_ARM = 1, MAGLEV_DISARM, MAGLEV_RESET = 4, MAGLEV_TRIP, MAGLEV_BYE };
enum maglev_status { MAGLEV_WELCOME, MAGLEV_OTHER_VERSION, MAGLEV_BUSY, MAGLEV_OTHER_CALIBRATION };
enum maglev_result { MAGLEV_DONE, MAGLEV_REFUSED };
enum maglev_flag { MAGLEV_HOLDING = 1, MAGLEV_ENABLED = 2 };
enum maglev_fault {
    MAGLEV_SENSOR_OUT_OF_RANGE = 1, MAGLEV_COIL_OVERTEMP = 2, MAGLEV_COIL_OVERCURRENT = 4, MAGLEV_FLOTOR_OVERSPEED = 8,
    MAGLEV_WATCHDOG = 32, MAGLEV_INVALID_COMMAND = 64, MAGLEV_ESTOPPED = 128, MAGLEV_COIL_NOT_FOLLOWING = 256,
    MAGLEV_SENSOR_FROZEN = 512, MAGLEV_HOST = 4096, MAGLEV_SENSOR_STOPPED = 8192, MAGLEV_COIL_NOT_OFF = 16384,
    MAGLEV_ALL_FAULTS = 32767
};
/* Why a frame was ignored: the first seven are no frames, the others none that may be obeyed. */
enum maglev_reason {
    MAGLEV_SHORT, MAGLEV_BAD_MAGIC, MAGLEV_BAD_CRC, MAGLEV_BAD_VERSION, MAGLEV_BAD_TYPE, MAGLEV_BAD_LENGTH,
    MAGLEV_BAD_TAG, MAGLEV_DIRECTION, MAGLEV_SESSION, MAGLEV_OLD, MAGLEV_NOT_ACTIVE, MAGLEV_BUSY_HELLO, MAGLEV_REASONS
};
extern const char *const maglev_reasons[MAGLEV_REASONS];

#define MAGLEV_NONE 0xFFFFFFFFu

/* What a device is. */
struct maglev_profile {
    uint64_t period;             /* between samples [ns] */
    uint64_t delay;              /* from a command's arrival to its taking effect [ns] */
    uint64_t watchdog;           /* how long it waits for a command [ns] */
    uint64_t enable;             /* how long the enable line may stand still before the amplifiers open [ns] */
    uint64_t stale;              /* how old the sample may be whose answer is obeyed [ns]; four periods are usual */
    double current_limit;        /* largest current in any coil [A] */
    double continuous_current;   /* that a coil bears for ever [A] */
    double hover_limit;          /* largest current in a coil that ARM's hover may have [A] */
    double thermal_time;         /* time constant of a coil's warming [s] */
    double spot_limit;           /* largest coordinate of a spot on its diode [m] */
    double spot_speed;           /* largest speed of a spot [m/s] */
    uint32_t frozen;             /* equal readings in a row that the sensor's noise rules out; 0: it has none */
    uint32_t device;             /* its number */
    uint32_t key_length;         /* 16 to 32 bytes, or 0 for no key */
    uint8_t key[MAGLEV_KEY];
    uint8_t calibration[MAGLEV_HASH];
    bool lockstep;               /* simulated time waits for each answer; false on a board */
};

/* What a board measures at a sample. */
struct maglev_reading {
    uint64_t time;                    /* instant of the sample [ns], a whole number of periods after any other */
    double spots[MAGLEV_SPOTS];       /* [m] */
    double measured[MAGLEV_COILS];    /* currents [A] */
    double commanded[MAGLEV_COILS];   /* currents that the amplifiers are told at that instant [A] */
    uint32_t number;                  /* of the sample; one that was missed has had its number too */
    uint32_t conversions;             /* counted by the converter, not by the program: see README.md */
    uint8_t valid;                    /* bit k is set where diode k's spot can be trusted */
    bool enabled;                     /* the amplifier board's word that its enable line lives */
};

/* What a board does. `context` comes first in every call. No function waits. */
struct maglev_hardware {
    void *context;
    void (*read)(void *context, struct maglev_reading *reading);
    /* Currents [A] from `delay` after `now` on: `pulsed` for the first `width` seconds, then `held`. */
    void (*drive)(void *context, uint64_t now, const double *held, const double *pulsed, double width);
    /* All currents off at once, and what was still to come forgotten. */
    void (*cut)(void *context);
    /* Change the level of the enable line. */
    void (*toggle)(void *context, uint64_t now);
    /* The device's clock [ns], which never goes back. */
    uint64_t (*now)(void *context);
    /* 32 bits that nobody can guess. */
    uint32_t (*random)(void *context);
};

struct maglev_frame {
    uint8_t type;
    uint32_t session, sequence;
    uint64_t time;
    union {
        struct { uint64_t nonce; uint8_t calibration[MAGLEV_HASH]; } hello;
        struct {
            uint64_t nonce;
            uint8_t status, lockstep, version, state;
            uint32_t device;
            uint8_t calibration[MAGLEV_HASH];
            uint64_t period, delay, watchdog, enable, stale, fault_time;
            uint32_t faults, first, frozen;
            double current_limit, continuous_current, hover_limit, thermal_time, spot_limit, spot_speed;
        } hello_ack;
        struct { uint32_t request; uint8_t operation; uint32_t faults; double hover[MAGLEV_COILS]; } ctrl;
        struct { uint32_t request; uint8_t operation, result, state; uint32_t faults; } ctrl_ack;
        struct {
            double spots[MAGLEV_SPOTS];
            float currents[MAGLEV_COILS], temperatures[MAGLEV_COILS];
            uint8_t state, valid;
            uint16_t flags;
            uint32_t faults, answered, age, conversions;
        } state;
        struct { uint32_t answers, flags; double held[MAGLEV_COILS], pulsed[MAGLEV_COILS], width; } cmd;
        struct { uint64_t request; } estop;
        struct { uint64_t request; uint8_t state; uint32_t faults; uint64_t sampled; float currents[MAGLEV_COILS];
        } estop_ack;
    } of;
};

/* A device: one session at a time, a state, latched faults. The first half may be read by anyone, and is written by
   the functions below alone. */
struct maglev_device {
    const struct maglev_profile *profile;
    const struct maglev_hardware *hardware;
    uint64_t peer;                     /* to whom STATEs go, where there is a session */
    uint64_t fault_time;               /* when the first of the latched faults was raised [ns]; 0 for none */
    uint32_t session;                  /* its number; 0 for none */
    uint32_t faults, first;            /* latched; those of them that the first trip latched */
    uint32_t answered;                 /* sample of the newest answer that was taken, where `is_answered` */
    uint32_t counts[MAGLEV_REASONS];   /* frames ignored, by reason */
    uint8_t state;
    bool is_answered, holding;
    double rises[MAGLEV_COILS];        /* temperatures, 1 where a coil trips */

    /* the session */
    uint64_t nonce, heard;
    uint32_t sequence;
    struct { uint32_t request; uint8_t operation, result; bool any; } last;
    /* the flight */
    double hover[MAGLEV_COILS];
    uint64_t commanded_at;
    uint32_t answers;
    /* the sensors */
    double spots[MAGLEV_SPOTS], measured[MAGLEV_COILS];
    uint64_t sampled;
    uint32_t number, spots_number, conversions, same[3];
    uint8_t not_following, not_off, not_enabled;
    bool has_spots, has_conversions, has_sampled, heated;
};

/* Begin, inactive and with the currents cut. Return false, and do nothing, where the profile is not one of a device: a
   time or limit that is not above 0 or not finite, or that contradicts another (the protocol's page says which), a key
   of another length, a function that is missing. Profile and hardware are kept by reference. */
bool maglev_start(struct maglev_device *device, const struct maglev_profile *profile,
                  const struct maglev_hardware *hardware);

/* Take a frame that came from a peer, and write what is to be sent back to it, MAGLEV_LARGEST bytes at most. Return
   its length; 0 for nothing. A peer is any number that stands for an address; on a serial line always the same. */
size_t maglev_receive(struct maglev_device *device, const uint8_t *data, size_t length, uint64_t peer,
                      uint8_t *answer);

/* Read a sample, act on what is wrong, and write the STATE for the session's peer. Return its length; 0 where there is
   no session. */
size_t maglev_sample(struct maglev_device *device, uint8_t *frame);

/* Let currents [A] flow for so long [s]. A board that pulses calls it for each piece of constant current that ended
   since the sample before; where it was not called, maglev_sample() takes the measured currents for the whole time. */
void maglev_heat(struct maglev_device *device, double seconds, const double *currents);

/* Cut the currents and latch faults, for a reason of the board's own, such as an emergency stop that it noticed. */
void maglev_trip(struct maglev_device *device, uint32_t faults);

/* In lockstep, the host is gone: latch WATCHDOG if active, and end the session. */
void maglev_lose_host(struct maglev_device *device);

/* Write a frame, with a tag if the profile has a key; return its length. */
size_t maglev_encode(const struct maglev_profile *profile, struct maglev_frame *frame, uint8_t *data);

/* Read a frame; return MAGLEV_REASONS where it can be trusted, else the reason why not. */
enum maglev_reason maglev_decode(const struct maglev_profile *profile, const uint8_t *data, size_t length,
                                 struct maglev_frame *frame);

/* Write a frame as a serial line carries it, with a zero byte on either side, MAGLEV_STUFFED bytes at most; return
   its length. The frame has MAGLEV_LARGEST bytes at most. */
size_t maglev_stuff(const uint8_t *frame, size_t length, uint8_t *out);

/* Bytes of a serial line on their way to a frame; all zeros at the start. */
struct maglev_line { uint8_t data[MAGLEV_LARGEST]; uint16_t length; uint8_t code, left; bool lost; };

/* Take the next byte of a line; return the length of the frame that it ended, in `line->data` until the next byte, or
   0. What is no frame is skipped. */
size_t maglev_unstuff(struct maglev_line *line, uint8_t byte);

#endif
