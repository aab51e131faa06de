/* A reference device in C99: the device's side of docs/protocol.md over UDP, one file, libc alone.

       cc -std=c99 -O2 scripts/examples/device_client.c -o device_client -lm
       device_client --plant FILE [--port 0] [--rate 200] [--delay 0.0015] [--watchdog 0.05] [--lockstep]
                     [--calibration-hash HEX32] [--device 1] [--seconds 0]
       device_client --golden

   Its plant is six double integrators about the centre: a flotor, for small angles. FILE has five names, each before
   its numbers: wrench_per_current (36, by rows) [N/A, N m/A], inertia (6: the mass three times, then the moments) [kg,
   kg m^2], gravity (6: accelerations) [m/s^2, rad/s^2], spots_per_pose (36, by rows) [1, m], rest (6) [m, rad].

   It has no key, and so listens on 127.0.0.1 only. With one, TRAILER grows by 16, encode() puts the tag over header and
   body before the CRC, and broken() compares it, in constant time, as its last check; nothing else changes. Its coils
   and diodes are perfect: COIL_NOT_FOLLOWING and SENSOR_FROZEN have no guard here. */
#define _POSIX_C_SOURCE 200809L

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

/* ---- what is on the wire ---- */

enum { MAGIC = 0x4A4D, PROTOCOL = 1, TRAILER = 4, LARGEST = 512, COILS = 6, HASH = 16 };
enum { HELLO = 1, HELLO_ACK, CTRL, CTRL_ACK, STATE, CMD, TYPES };
enum { INACTIVE, ACTIVE, FAULT }; /* states */
enum { ARM = 1, DISARM, ESTOP, RESET, TRIP, BYE }; /* operations */
enum { WELCOME, OTHER_VERSION, BUSY, OTHER_CALIBRATION }; /* answers to a HELLO */
enum { DONE, REFUSED, HOLDING = 1 }; /* answers to a CTRL; flag of a STATE */
enum { /* faults */
    SENSOR_OUT_OF_RANGE = 1, COIL_OVERTEMP = 2, COIL_OVERCURRENT = 4, FLOTOR_OVERSPEED = 8, WATCHDOG = 32,
    INVALID_COMMAND = 64, BY_ESTOP = 128, BY_HOST = 4096, ALL_FAULTS = 8191
};
#define NONE 0xFFFFFFFFu
#define SILENCE UINT64_C(1000000000)    /* a session is another host's after so long without a frame */
#define AGAIN UINT64_C(20000000)        /* lockstep: a STATE is sent again after so long without an answer */
#define LET_GO UINT64_C(2000000000)     /* lockstep: and the host is given up after so long */
static const size_t SIZES[TYPES] = {0, 44, 116, 80, 32, 132, 132}; /* header and body */

static void fail(const char *what, const char *name) {
    fprintf(stderr, "device_client: %s: %s\n", what, name);
    exit(2);
}

struct frame {
    uint8_t type;
    uint32_t session, sequence;
    uint64_t time;
    union {
        struct { uint64_t nonce; uint8_t calibration[HASH]; } hello;
        struct {
            uint64_t nonce;
            uint8_t status, lockstep, version, state;
            uint32_t device;
            uint8_t calibration[HASH];
            uint64_t period, delay, watchdog;
            double current_limit, continuous_current, thermal_time, spot_limit, spot_speed;
        } hello_ack;
        struct { uint32_t request; uint8_t operation; uint32_t faults; double hover[COILS]; } ctrl;
        struct { uint32_t request; uint8_t operation, result, state; uint32_t faults; } ctrl_ack;
        struct {
            double spots[6];
            float currents[COILS], warmth[COILS];
            uint8_t state, valid;
            uint16_t flags;
            uint32_t faults, answered, age;
        } state;
        struct { uint32_t answers, flags; double held[COILS], pulsed[COILS], width; } cmd;
    } of;
};

/* One walk over a frame's fields both writes and reads them, byte by byte, the lowest first. */
struct cursor { uint8_t *at; int writing; };

static uint64_t bytes(struct cursor *c, uint64_t value, int count) {
    uint64_t found = 0;
    for (int i = 0; i < count; i++, c->at++) {
        if (c->writing) *c->at = (uint8_t)(value >> (8 * i));
        found |= (uint64_t)*c->at << (8 * i);
    }
    return found;
}

static void u8(struct cursor *c, uint8_t *value) { *value = (uint8_t)bytes(c, *value, 1); }
static void u16(struct cursor *c, uint16_t *value) { *value = (uint16_t)bytes(c, *value, 2); }
static void u32(struct cursor *c, uint32_t *value) { *value = (uint32_t)bytes(c, *value, 4); }
static void u64(struct cursor *c, uint64_t *value) { *value = bytes(c, *value, 8); }
static void gap(struct cursor *c, int count) { (void)bytes(c, 0, count); }

static void f64(struct cursor *c, double *values, int count) {
    for (uint64_t bits; count--; values++) {
        memcpy(&bits, values, sizeof bits);
        bits = bytes(c, bits, 8);
        memcpy(values, &bits, sizeof bits);
    }
}

static void f32(struct cursor *c, float *values, int count) {
    for (uint32_t bits; count--; values++) {
        memcpy(&bits, values, sizeof bits);
        bits = (uint32_t)bytes(c, bits, 4);
        memcpy(values, &bits, sizeof bits);
    }
}

static void hash(struct cursor *c, uint8_t *value) { for (int i = 0; i < HASH; i++) u8(c, &value[i]); }

static void walk(struct cursor *c, struct frame *f) {
    uint16_t magic = MAGIC;
    uint8_t version = PROTOCOL;
    u16(c, &magic), u8(c, &version), u8(c, &f->type), u32(c, &f->session), u32(c, &f->sequence), u64(c, &f->time);
    switch (f->type) {
    case HELLO: u64(c, &f->of.hello.nonce), hash(c, f->of.hello.calibration); break;
    case HELLO_ACK: u64(c, &f->of.hello_ack.nonce), u8(c, &f->of.hello_ack.status), u8(c, &f->of.hello_ack.lockstep);
        u8(c, &f->of.hello_ack.version), u8(c, &f->of.hello_ack.state), u32(c, &f->of.hello_ack.device);
        hash(c, f->of.hello_ack.calibration), u64(c, &f->of.hello_ack.period), u64(c, &f->of.hello_ack.delay);
        u64(c, &f->of.hello_ack.watchdog), f64(c, &f->of.hello_ack.current_limit, 1);
        f64(c, &f->of.hello_ack.continuous_current, 1), f64(c, &f->of.hello_ack.thermal_time, 1);
        f64(c, &f->of.hello_ack.spot_limit, 1), f64(c, &f->of.hello_ack.spot_speed, 1); break;
    case CTRL: u32(c, &f->of.ctrl.request), u8(c, &f->of.ctrl.operation), gap(c, 3), u32(c, &f->of.ctrl.faults);
        f64(c, f->of.ctrl.hover, COILS); break;
    case CTRL_ACK: u32(c, &f->of.ctrl_ack.request), u8(c, &f->of.ctrl_ack.operation), u8(c, &f->of.ctrl_ack.result);
        u8(c, &f->of.ctrl_ack.state), gap(c, 1), u32(c, &f->of.ctrl_ack.faults); break;
    case STATE: f64(c, f->of.state.spots, 6), f32(c, f->of.state.currents, COILS), f32(c, f->of.state.warmth, COILS);
        u8(c, &f->of.state.state), u8(c, &f->of.state.valid), u16(c, &f->of.state.flags), u32(c, &f->of.state.faults);
        u32(c, &f->of.state.answered), u32(c, &f->of.state.age); break;
    default: u32(c, &f->of.cmd.answers), u32(c, &f->of.cmd.flags), f64(c, f->of.cmd.held, COILS);
        f64(c, f->of.cmd.pulsed, COILS), f64(c, &f->of.cmd.width, 1);
    }
}

static uint32_t crc32(const uint8_t *data, size_t length) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t bit = 0; bit < 8 * length; bit++) {
        if (bit % 8 == 0) crc ^= data[bit / 8];
        crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

static size_t encode(struct frame *f, uint8_t *data) {
    struct cursor c = {data, 1};
    walk(&c, f);
    (void)bytes(&c, crc32(data, SIZES[f->type]), 4);
    return SIZES[f->type] + TRAILER;
}

/* What was ignored, by reason: the first six after SOUND are no frames, the others none that may be obeyed. */
enum {
    SOUND, SHORT, BAD_MAGIC, BAD_CRC, VERSION, TYPE, LENGTH, DIRECTION, SESSION, OLD, NOT_ACTIVE, BUSY_HELLO, REASONS
};
static const char *const NAMES[REASONS] = {"sound", "short", "magic", "crc", "version", "type", "length", "direction",
                                           "session", "old", "inactive", "busy"};

static int broken(uint8_t *data, size_t length) {
    if (length < 4) return SHORT;
    if (data[0] != (MAGIC & 0xFF) || data[1] != MAGIC >> 8) return BAD_MAGIC;
    if (length < 4 + TRAILER) return BAD_CRC;
    struct cursor c = {data + length - 4, 0};
    if (bytes(&c, 0, 4) != crc32(data, length - 4)) return BAD_CRC;
    if (data[2] != PROTOCOL) return VERSION;
    if (data[3] < HELLO || data[3] >= TYPES) return TYPE;
    return length == SIZES[data[3]] + TRAILER ? SOUND : LENGTH;
}

/* RFC 1982 */
static int newer(uint32_t one, uint32_t other) { return one != other && one - other < 0x80000000u; }

/* ---- the plant: its time in whole nanoseconds, exact between switches of the currents ---- */

enum { SWITCHES = 64 };
struct drive { uint64_t at, pulse_end; double held[COILS], pulsed[COILS]; };
struct plant {
    double wrench[36], inertia[6], gravity[6], slopes[36], rest[6], continuous_current, thermal_time;
    double pose[6], twist[6], warmth[COILS];
    uint64_t now;
    struct drive on, due[SWITCHES];
    int waiting, lying;
};

static const double *flowing(const struct plant *p) { return p->now < p->on.pulse_end ? p->on.pulsed : p->on.held; }

static void move(struct plant *p, double duration) {
    const double *currents = flowing(p);
    double share = -expm1(-duration / p->thermal_time), pull[6];
    for (int i = 0; i < 6; i++) {
        double ratio = currents[i] / p->continuous_current, wrench = 0.0;
        p->warmth[i] += share * (ratio * ratio - p->warmth[i]);
        for (int j = 0; j < COILS; j++) wrench += p->wrench[6 * i + j] * currents[j];
        pull[i] = wrench / p->inertia[i] + p->gravity[i];
    }
    if (p->lying && !(pull[2] > 0.0)) return;
    p->lying = 0;
    for (int i = 0; i < 6; i++) {
        p->pose[i] += duration * (p->twist[i] + 0.5 * duration * pull[i]);
        p->twist[i] += duration * pull[i];
    }
    if (p->pose[2] <= p->rest[2] && p->twist[2] <= 0.0) { /* it lands, and stays where it is */
        p->pose[2] = p->rest[2], p->lying = 1;
        memset(p->twist, 0, sizeof p->twist);
    }
}

static void advance(struct plant *p, uint64_t now) {
    for (;;) {
        while (p->waiting && p->due[0].at <= p->now) {
            p->on = p->due[0];
            memmove(p->due, p->due + 1, (size_t)--p->waiting * sizeof *p->due);
        }
        if (p->now >= now) return;
        uint64_t next = now;
        if (p->waiting && p->due[0].at < next) next = p->due[0].at;
        if (p->now < p->on.pulse_end && p->on.pulse_end < next) next = p->on.pulse_end;
        move(p, (double)(next - p->now) * 1e-9);
        p->now = next;
    }
}

static void drive(struct plant *p, uint64_t at, const double *held, const double *pulsed, double width) {
    while (p->waiting && p->due[p->waiting - 1].at >= at) p->waiting--;
    if (p->waiting == SWITCHES) p->waiting--; /* more than 64 within the delay: the newest counts */
    struct drive *next = &p->due[p->waiting++];
    next->at = at, next->pulse_end = at + (uint64_t)(width * 1e9 + 0.5);
    memcpy(next->held, held, sizeof next->held);
    memcpy(next->pulsed, pulsed, sizeof next->pulsed);
}

static void cut(struct plant *p) {
    p->waiting = 0;
    memset(&p->on, 0, sizeof p->on);
}

/* ---- the device: one session, a state, latched faults ---- */

struct device {
    struct plant plant;
    int socket, lockstep;
    uint32_t number;
    uint8_t calibration[HASH];
    uint64_t period, delay, watchdog, begun;
    double current_limit, spot_limit, spot_speed;
    uint8_t state;
    uint32_t faults, session, sequence;
    uint64_t nonce, heard, tick;
    struct sockaddr_in peer;
    int requested, answered, seen, holding; /* whether there was a request, an answer to the last sample, a last spot */
    struct frame acknowledgement;
    double hover[COILS], last[6];
    uint64_t commanded_at;
    uint32_t answers;
    unsigned long counts[REASONS];
};

static size_t ignore(struct device *d, int reason) {
    d->counts[reason]++;
    return 0;
}

static void trip(struct device *d, uint32_t faults) {
    cut(&d->plant);
    d->holding = 0, d->state = FAULT, d->faults |= faults;
}

static void lose_host(struct device *d) {
    if (d->state == ACTIVE) trip(d, WATCHDOG);
    d->session = 0;
}

static uint32_t refusal(const struct device *d, const double *held, const double *pulsed, double width) {
    double most = d->current_limit * (1.0 + 1e-9);
    uint32_t fault = 0;
    for (int i = 0; i < COILS; i++) {
        if (!isfinite(held[i]) || !isfinite(pulsed[i])) return INVALID_COMMAND;
        if (fabs(held[i]) > most || fabs(pulsed[i]) > most) fault = COIL_OVERCURRENT;
    }
    return width >= 0.0 && width <= 1.0 ? fault : INVALID_COMMAND; /* NaN is neither */
}

static double warmest(const struct device *d) {
    double most = 0.0;
    for (int i = 0; i < COILS; i++) most = d->plant.warmth[i] > most ? d->plant.warmth[i] : most;
    return most;
}

static size_t greet(struct device *d, uint64_t now, uint64_t nonce, uint8_t status, uint8_t *answer) {
    struct frame f = {HELLO_ACK, status == WELCOME ? d->session : 0, 0, now, .of.hello_ack = {
        .nonce = nonce, .status = status, .lockstep = (uint8_t)d->lockstep, .version = PROTOCOL, .state = d->state,
        .device = d->number, .period = d->period, .delay = d->delay, .watchdog = d->watchdog,
        .current_limit = d->current_limit, .continuous_current = d->plant.continuous_current,
        .thermal_time = d->plant.thermal_time, .spot_limit = d->spot_limit, .spot_speed = d->spot_speed}};
    memcpy(f.of.hello_ack.calibration, d->calibration, HASH);
    return encode(&f, answer);
}

static uint32_t draw(void) { /* a number that nobody can guess, and not 0 */
    uint32_t number = 0;
    FILE *source = fopen("/dev/urandom", "rb");
    if (!source || fread(&number, sizeof number, 1, source) != 1) fail("cannot be read", "/dev/urandom");
    fclose(source);
    return number ? number : 1;
}

static size_t hello(struct device *d, struct frame *f, uint64_t now, int same_peer, const struct sockaddr_in *peer,
                    uint8_t *answer) {
    uint64_t nonce = f->of.hello.nonce;
    if (!(d->session && nonce == d->nonce && same_peer)) { /* else the answer before was lost */
        if (d->session && (d->state == ACTIVE || now - d->heard < SILENCE))
            return ignore(d, BUSY_HELLO), greet(d, now, nonce, BUSY, answer);
        if (memcmp(f->of.hello.calibration, d->calibration, HASH))
            return greet(d, now, nonce, OTHER_CALIBRATION, answer);
        d->session = draw(), d->nonce = nonce, d->peer = *peer;
        d->sequence = 0, d->requested = 0, d->answered = 0, d->answers = NONE;
    }
    d->heard = now;
    return greet(d, now, nonce, WELCOME, answer);
}

static int perform(struct device *d, const struct frame *f, uint64_t now) {
    uint32_t known = f->of.ctrl.faults & ALL_FAULTS;
    switch (f->of.ctrl.operation) {
    case ESTOP: trip(d, BY_ESTOP); return DONE;
    case TRIP: trip(d, known ? known : BY_HOST); return DONE;
    case RESET:
        if (d->state == ACTIVE || !(warmest(d) < 0.8)) return REFUSED;
        d->state = INACTIVE, d->faults = 0;
        return DONE;
    case ARM:
        if (d->state != INACTIVE || refusal(d, f->of.ctrl.hover, f->of.ctrl.hover, 0.0)) return REFUSED;
        memcpy(d->hover, f->of.ctrl.hover, sizeof d->hover);
        d->state = ACTIVE, d->commanded_at = now, d->answers = NONE, d->holding = 0, d->seen = 0;
        return DONE;
    case DISARM: case BYE:
        if (d->state == ACTIVE) cut(&d->plant), d->holding = 0, d->state = INACTIVE;
        return DONE;
    default: return REFUSED;
    }
}

static size_t control(struct device *d, const struct frame *f, uint64_t now, uint8_t *answer) {
    struct frame *last = &d->acknowledgement;
    if (!d->requested || f->of.ctrl.request != last->of.ctrl_ack.request) {
        if (d->requested && !newer(f->of.ctrl.request, last->of.ctrl_ack.request)) return ignore(d, OLD);
        last->of.ctrl_ack.request = f->of.ctrl.request;
        last->of.ctrl_ack.operation = f->of.ctrl.operation;
        last->of.ctrl_ack.result = (uint8_t)perform(d, f, now);
        d->requested = 1;
    }
    last->type = CTRL_ACK, last->session = d->session, last->sequence = 0, last->time = now;
    last->of.ctrl_ack.state = d->state, last->of.ctrl_ack.faults = d->faults;
    if (last->of.ctrl_ack.operation == BYE) d->session = 0;
    return encode(last, answer);
}

static size_t obey(struct device *d, const struct frame *f, uint64_t now) {
    if ((uint32_t)d->tick - f->of.cmd.answers > (d->lockstep ? 0 : d->watchdog / d->period))
        return ignore(d, OLD); /* the answer before, sent again because it seemed lost */
    d->answered = 1;
    if (d->state != ACTIVE) return ignore(d, NOT_ACTIVE);
    uint32_t wrong = refusal(d, f->of.cmd.held, f->of.cmd.pulsed, f->of.cmd.width);
    if (wrong) return trip(d, wrong), 0;
    d->commanded_at = now, d->answers = f->of.cmd.answers, d->holding = 0;
    drive(&d->plant, now + d->delay, f->of.cmd.held, f->of.cmd.pulsed, f->of.cmd.width);
    return 0;
}

/* Take a datagram; return the length of what is to be sent back to its sender. */
static size_t take(struct device *d, uint8_t *data, size_t length, const struct sockaddr_in *peer, uint64_t now,
                   uint8_t *answer) {
    int reason = broken(data, length);
    if (reason) ignore(d, reason);
    if (reason) return reason == VERSION && data[3] == HELLO ? greet(d, now, 0, OTHER_VERSION, answer) : 0;
    struct frame f = {.type = 0};
    struct cursor c = {data, 0};
    walk(&c, &f);
    int same_peer = peer->sin_addr.s_addr == d->peer.sin_addr.s_addr && peer->sin_port == d->peer.sin_port;
    if (f.type == HELLO) return hello(d, &f, now, same_peer, peer, answer);
    if (f.type != CTRL && f.type != CMD) return ignore(d, DIRECTION);
    if (!d->session || f.session != d->session || !same_peer) return ignore(d, SESSION);
    if (!newer(f.sequence, d->sequence)) return ignore(d, OLD);
    d->sequence = f.sequence, d->heard = now;
    return f.type == CTRL ? control(d, &f, now, answer) : obey(d, &f, now);
}

static uint32_t look(struct device *d, const double *spots, uint8_t *valid) {
    double step = d->spot_speed * (double)d->period * 1e-9, fastest = 0.0;
    for (int i = 0; i < 6; i++) {
        if (!(fabs(spots[i]) <= d->spot_limit)) *valid &= (uint8_t)~(1 << i / 2);
        fastest = fmax(fastest, fabs(spots[i] - d->last[i]));
    }
    int before = d->seen;
    d->seen = *valid == 7;
    memcpy(d->last, spots, sizeof d->last);
    if (!d->seen || (before && fastest >= 4.0 * step))
        return SENSOR_OUT_OF_RANGE; /* faster than any flotor: it is the sensor that jumped */
    return before && fastest > step ? FLOTOR_OVERSPEED : 0;
}

/* Sample at an instant, act on what is wrong, and write the STATE; 0 where there is no session. */
static size_t sample(struct device *d, uint64_t now, uint8_t *data) {
    struct plant *p = &d->plant;
    struct frame f = {.type = STATE, .session = d->session, .sequence = (uint32_t)d->tick, .time = now};
    advance(p, now);
    f.of.state.valid = 7;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) f.of.state.spots[i] += p->slopes[6 * i + j] * p->pose[j];
    for (int i = 0; i < COILS; i++)
        f.of.state.currents[i] = (float)flowing(p)[i], f.of.state.warmth[i] = (float)p->warmth[i];
    uint32_t wrong = look(d, f.of.state.spots, &f.of.state.valid);
    uint64_t missing = now - d->commanded_at;
    if (d->state == ACTIVE && !d->lockstep) {
        if (missing > d->watchdog) wrong |= WATCHDOG;
        else if (missing > 2 * d->period && !d->holding)
            d->holding = 1, drive(p, now + d->delay, d->hover, d->hover, 0.0);
    }
    if (d->state == ACTIVE && wrong) trip(d, wrong);
    if (!(warmest(d) < 1.0)) trip(d, COIL_OVERTEMP);
    d->answered = 0;
    if (!d->session) return 0;
    f.of.state.state = d->state, f.of.state.flags = d->holding ? HOLDING : 0, f.of.state.faults = d->faults;
    f.of.state.answered = d->answers, f.of.state.age = NONE;
    if (d->answers != NONE) f.of.state.age = missing / 1000 < NONE ? (uint32_t)(missing / 1000) : NONE - 1;
    return encode(&f, data);
}

/* ---- sockets, clocks, arguments ---- */

static volatile sig_atomic_t ended;
static void end(int number) { (void)number, ended = 1; }

static uint64_t clock_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

/* One that cannot leave is lost, as on any line. */
static void send_to(const struct device *d, const uint8_t *data, size_t length, const struct sockaddr_in *peer) {
    if (length) (void)!sendto(d->socket, data, length, 0, (const struct sockaddr *)peer, sizeof *peer);
}

/* Wait for one datagram until an instant of the machine's clock, and take it. */
static void hear(struct device *d, uint64_t until) {
    uint64_t now = clock_now(), left = until > now ? until - now : 0;
    struct timespec wait = {(time_t)(left / 1000000000u), (long)(left % 1000000000u)};
    fd_set ready;
    FD_ZERO(&ready);
    FD_SET(d->socket, &ready);
    if (pselect(d->socket + 1, &ready, NULL, NULL, &wait, NULL) < 1) return;
    uint8_t data[LARGEST], answer[LARGEST];
    struct sockaddr_in peer;
    socklen_t size = sizeof peer;
    ssize_t length = recvfrom(d->socket, data, sizeof data, 0, (struct sockaddr *)&peer, &size);
    if (length < 0) return; /* word of a datagram that nobody took */
    if (!d->lockstep) { /* what comes after the next sample is due belongs to that sample's instant */
        uint64_t due = (d->tick + 1) * d->period, passed = clock_now() - d->begun;
        advance(&d->plant, passed < due ? passed : due);
    }
    send_to(d, answer, take(d, data, (size_t)length, &peer, d->plant.now, answer), &peer);
}

/* Simulated time waits for the answer to each sample; without a host it stands still. */
static void in_lockstep(struct device *d, uint64_t stop) {
    uint8_t data[LARGEST];
    while (!ended && clock_now() < stop) {
        while (!d->session && !ended && clock_now() < stop) hear(d, clock_now() + AGAIN);
        if (!d->session) return;
        d->tick++;
        uint32_t session = d->session;
        size_t length = sample(d, d->tick * d->period, data);
        uint64_t sent = clock_now(), again = sent;
        while (!ended && d->session == session && !d->answered) {
            if (clock_now() >= again) send_to(d, data, length, &d->peer), again = clock_now() + AGAIN;
            hear(d, again);
            if (clock_now() - sent > LET_GO) lose_host(d);
        }
    }
}

/* Samples are due at whole periods; those that were missed are left out, never caught up. */
static void in_real_time(struct device *d, uint64_t stop) {
    uint8_t data[LARGEST];
    while (!ended && clock_now() < stop) {
        uint64_t due = d->begun + (d->tick + 1) * d->period;
        while (!ended && clock_now() < due) hear(d, due);
        d->tick += (clock_now() - due) / d->period + 1;
        size_t length = sample(d, d->tick * d->period, data);
        send_to(d, data, length, &d->peer);
    }
}

static void read_plant(struct plant *p, const char *path) {
    static const char *const names[] = {"wrench_per_current", "inertia", "gravity", "spots_per_pose", "rest"};
    double *const places[] = {p->wrench, p->inertia, p->gravity, p->slopes, p->rest};
    FILE *file = fopen(path, "r");
    if (!file) fail("cannot be read", path);
    for (int i = 0; i < 5; i++) {
        char name[32];
        if (fscanf(file, "%31s", name) != 1 || strcmp(name, names[i]))
            fail("not in its place in the plant's file", names[i]);
        for (int k = 0; k < (i == 0 || i == 3 ? 36 : 6); k++)
            if (fscanf(file, "%lf", &places[i][k]) != 1 || !isfinite(places[i][k]))
                fail("too few numbers, or one that is none", names[i]);
    }
    fclose(file);
    for (int i = 0; i < 6; i++)
        if (!(p->inertia[i] > 0.0)) fail("must be above 0", names[1]);
    memcpy(p->pose, p->rest, sizeof p->pose);
    p->lying = 1;
}

static void read_hash(uint8_t *place, const char *text) {
    if (strlen(text) != 2 * HASH || strspn(text, "0123456789abcdefABCDEF") != 2 * HASH)
        fail("must be 32 hexadecimal digits", "--calibration-hash");
    for (int i = 0; i < HASH; i++) {
        char pair[] = {text[2 * i], text[2 * i + 1], 0};
        place[i] = (uint8_t)strtoul(pair, NULL, 16);
    }
}

/* Print the frames of docs/protocol.md, each read back and written again on the way. */
static int golden(void) {
#define KNOWN {0, 17, 34, 51, 68, 85, 102, 119, 136, 153, 170, 187, 204, 221, 238, 255}
    static struct frame frames[] = {
        {HELLO, 0, 1, 1000000, .of.hello = {UINT64_C(0x0123456789ABCDEF), KNOWN}},
        {HELLO_ACK, 0x0A0B0C0D, 0, 2000000, .of.hello_ack = {UINT64_C(0x0123456789ABCDEF), WELCOME, 1, PROTOCOL,
         INACTIVE, 7, KNOWN, 5000000, 1500000, 50000000, 10.0, 3.0, 10.0, 0.012, 1.0}},
        {CTRL, 0x0A0B0C0D, 2, 3000000, .of.ctrl = {1, ARM, 0, {1.125, 1.125, 1.125, 0.0, -0.5, 0.5}}},
        {CTRL_ACK, 0x0A0B0C0D, 0, 4000000, .of.ctrl_ack = {1, ARM, REFUSED, FAULT, 0x121}},
        {STATE, 0x0A0B0C0D, 0x10203, 5000000, .of.state = {{0.001, -0.002, 0.003, -0.004, 0.005, -0.006},
         {1.125f, 1.125f, 1.125f, 0.0f, -0.5f, 0.5f}, {0.125f, 0.25f, 0.375f, 0.5f, 0.625f, 0.75f},
         ACTIVE, 7, HOLDING, 0, 0x10200, 12345}},
        {CMD, 0x0A0B0C0D, 3, 6000000, .of.cmd = {0x10203, 0, {1.125, 1.125, 1.125, 0.0, -0.5, 0.5},
         {10.0, 9.0, 8.0, -2.0, -3.0, -4.0}, 0.0005}}};
    uint8_t data[LARGEST];
    for (int i = 0; i < TYPES - HELLO; i++) {
        struct frame again = {.type = 0};
        size_t length = encode(&frames[i], data);
        struct cursor c = {data, 0};
        if (broken(data, length)) return 1;
        walk(&c, &again);
        length = encode(&again, data);
        for (size_t k = 0; k < length; k++) printf("%02x", data[k]);
        printf("\n");
    }
    return 0;
}

int main(int count, char **arguments) {
    static struct device d = {.answers = NONE, .current_limit = 10.0, .spot_limit = 0.012, .spot_speed = 1.0,
                              .plant = {.continuous_current = 3.0, .thermal_time = 10.0}};
    struct { const char *name; double value, least, most; } numbers[] = {
        {"--port", 0.0, 0.0, 65535.0}, {"--rate", 200.0, 1.0, 1e5}, {"--delay", 0.0015, 0.0, 0.1},
        {"--watchdog", 0.05, 0.001, 10.0}, {"--device", 1.0, 0.0, 4294967295.0}, {"--seconds", 0.0, 0.0, 1e6}};
    const char *plant = NULL;
    char rest;
    for (int i = 1, k; i < count; i += 2) {
        const char *name = arguments[i], *value = i + 1 < count ? arguments[i + 1] : "";
        if (!strcmp(name, "--golden")) return golden();
        for (k = 0; k < 6 && strcmp(name, numbers[k].name);) k++;
        if (!strcmp(name, "--lockstep")) d.lockstep = 1, i--;
        else if (!strcmp(name, "--plant")) plant = value;
        else if (!strcmp(name, "--calibration-hash")) read_hash(d.calibration, value);
        else if (k == 6) fail("no such argument", name);
        else if (sscanf(value, "%lf%c", &numbers[k].value, &rest) != 1 || !(numbers[k].value >= numbers[k].least) ||
                 !(numbers[k].value <= numbers[k].most)) fail("not a number that is allowed", name);
    }
    if (!plant) fail("needed", "--plant FILE");
    read_plant(&d.plant, plant);
    d.period = (uint64_t)(1e9 / numbers[1].value + 0.5), d.delay = (uint64_t)(numbers[2].value * 1e9 + 0.5);
    d.watchdog = (uint64_t)(numbers[3].value * 1e9 + 0.5), d.number = (uint32_t)numbers[4].value;

    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)numbers[0].value)};
    socklen_t size = sizeof address;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    d.socket = socket(AF_INET, SOCK_DGRAM, 0);
    if (d.socket < 0 || bind(d.socket, (struct sockaddr *)&address, size) ||
        getsockname(d.socket, (struct sockaddr *)&address, &size) || fcntl(d.socket, F_SETFL, O_NONBLOCK))
        fail("cannot listen", strerror(errno));
    struct sigaction action = {.sa_handler = end};
    sigaction(SIGTERM, &action, NULL), sigaction(SIGINT, &action, NULL);
    printf("listening udp://127.0.0.1:%u\n", ntohs(address.sin_port));
    fflush(stdout);
    d.begun = clock_now();
    uint64_t stop = numbers[5].value > 0.0 ? d.begun + (uint64_t)(numbers[5].value * 1e9) : UINT64_MAX;
    (d.lockstep ? in_lockstep : in_real_time)(&d, stop);
    for (int i = 1; i < REASONS; i++) printf("%s %lu%s", NAMES[i], d.counts[i], i + 1 < REASONS ? ", " : "\n");
    close(d.socket);
    return 0;
}
