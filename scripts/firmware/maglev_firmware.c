/* See maglev_firmware.h. Sections: bytes and numbers, CRC and tag, frames, serial line, temperatures, guards, walls,
   states, session.

   Bounded time: every loop below runs over the coils, the spots, or the bytes of a frame, of which there are
   MAGLEV_LARGEST at most; nothing waits and nothing calls itself. How many frames are processed between two samples is
   for the board to bound, by time: see maglev_queue.h. The longest ways through are
     maglev_receive  a HELLO with a key: its CRC and tag, and those of the answer; 32 000 instructions of a Cortex-M4. A
                     CMD: 16 000, without a key 7 000; with one wall 25 000 and 15 500, with twelve 72 000 and 51 000.
                     600 bytes that are no frame: 8 000.
     maglev_sample   read(), the guards, one exp step, one drive() or cut(), toggle(), CRC and tag of the STATE;
                     27 000 instructions, without a key 18 000. In a controlled stop 2 000 more.
     maglev_wall     read(), the guard of the spots, two products of six by six, add(); 20 000 instructions with one wall,
                     48 000 with six, each with a filter; 39 000 with twelve without one.
   Add 4 400 for each maglev_heat() and what the hardware's functions take. Doubles are the wire's; a Cortex-M4
   computes them in software, which is in these figures. */
#include "maglev_firmware.h"

#define SILENCE UINT64_C(1000000000) /* [ns]; another host may take over after this time without a frame */
#define LONGEST UINT64_C(1000000000) /* [ns]; largest watchdog timeout */
#define GAP 2          /* periods without a command before hover currents */
#define LONGEST_STOP 1.0 /* [s] */
/* TRIP with these only: controlled stop. */
#define SOFT (MAGLEV_WATCHDOG | MAGLEV_INVALID_COMMAND | MAGLEV_CLOCK | MAGLEV_HOST)
#define PATIENCE 3     /* consecutive samples with a wrong current */
#define CLOSE_SHARE 0.1 /* of a command, tolerated beside `off_current` */
#define IMPLAUSIBLE 4.0 /* times the largest spot speed: a sensor error */
#define WARNING_RISE 0.8 /* temperature at which RESET is refused */
#define ROUNDING 1e-9  /* of the host's currents */
#define MEMORY 1.0     /* [s]; in which generated energy is forgotten */
#define TWO_PI 6.283185307179586

enum { MAGIC = 0x4A4D, HEADER = 20, CRC = 4, TAG = 16, BLOCK = 64, WALL = 36 };

const char *const maglev_reasons[MAGLEV_REASONS] = {"short", "magic", "crc", "version", "type", "length", "tag",
                                                    "direction", "session", "old", "inactive", "busy"};
static const uint8_t SIZES[MAGLEV_TYPES] = {0, 44, 244, 144, 32, 136, 132, 28, 76}; /* of header and body */

#ifdef MAGLEV_NO_LIBRARY /* what the compiler needs of a C library */
void *memset(void *start, int value, size_t count);
void *memset(void *start, int value, size_t count) {
    for (volatile uint8_t *to = start; count; count--) *to++ = (uint8_t)value; /* volatile: else it may call itself */
    return start;
}
#endif

/* ---- bytes and numbers ---- */

static void copy_bytes(uint8_t *to, const uint8_t *from, size_t count) {
    for (size_t i = 0; i < count; i++) to[i] = from[i];
}

/* In constant time. */
static bool same_bytes(const uint8_t *one, const uint8_t *other, size_t count) {
    unsigned difference = 0;
    for (size_t i = 0; i < count; i++) difference |= one[i] ^ other[i];
    return difference == 0;
}

static void copy_six(double *to, const double *from) {
    for (int i = 0; i < 6; i++) to[i] = from[i];
}

static double size(double value) { return value < 0.0 ? -value : value; }

/* By the exponent: -ffast-math cannot remove it. */
static bool finite(double value) {
    union { double value; uint64_t bits; } both = {value};
    return (both.bits >> 52 & 0x7FF) != 0x7FF;
}

/* As f32, finite values clamped to its range: beyond it the conversion is undefined. */
static float single(double value) {
    const uint64_t largest = UINT64_C(0x47EFFFFFE0000000), infinite = UINT64_C(0x7FF0000000000000);
    union { double value; uint64_t bits; } both = {value};
    uint64_t magnitude = both.bits << 1 >> 1;
    if (magnitude > largest && magnitude < infinite) both.bits += largest - magnitude;
    return (float)both.value;
}

static bool all_finite(const double *values) {
    for (int i = 0; i < 6; i++)
        if (!finite(values[i])) return false;
    return true;
}

static bool all_within(const double *values, double most) {
    for (int i = 0; i < 6; i++)
        if (!(size(values[i]) <= most)) return false;
    return true;
}

/* RFC 1982 */
static bool newer(uint32_t one, uint32_t other) { return one != other && one - other < 0x80000000u; }

/* ---- CRC and tag ---- */

static uint32_t crc32(const uint8_t *data, size_t length) {
    static const uint32_t table[16] = {
        0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
        0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc ^= data[i];
        crc = crc >> 4 ^ table[crc & 15];
        crc = crc >> 4 ^ table[crc & 15];
    }
    return ~crc;
}

static const uint32_t BLAKE_START[8] = {0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A,
                                        0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19};

static uint32_t turned(uint32_t value, int bits) { return value >> bits | value << (32 - bits); }

#define MIX(a, b, c, d, k) do { \
    v[a] += v[b] + m[s[k]], v[d] = turned(v[d] ^ v[a], 16), v[c] += v[d], v[b] = turned(v[b] ^ v[c], 12); \
    v[a] += v[b] + m[s[k + 1]], v[d] = turned(v[d] ^ v[a], 8), v[c] += v[d], v[b] = turned(v[b] ^ v[c], 7); \
} while (0)

static void compress(uint32_t *h, const uint8_t *block, uint32_t count, bool last) {
    static const uint8_t order[10][16] = {
        {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
        {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
        {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
        {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
        {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0}};
    uint32_t m[16], v[16];
    for (int i = 0; i < 16; i++, block += 4)
        m[i] = (uint32_t)block[0] | (uint32_t)block[1] << 8 | (uint32_t)block[2] << 16 | (uint32_t)block[3] << 24;
    for (int i = 0; i < 8; i++) v[i] = h[i], v[i + 8] = BLAKE_START[i];
    v[12] ^= count;
    if (last) v[14] = ~v[14];
    for (int round = 0; round < 10; round++) {
        const uint8_t *s = order[round];
        MIX(0, 4, 8, 12, 0); MIX(1, 5, 9, 13, 2); MIX(2, 6, 10, 14, 4); MIX(3, 7, 11, 15, 6);
        MIX(0, 5, 10, 15, 8); MIX(1, 6, 11, 12, 10); MIX(2, 7, 8, 13, 12); MIX(3, 4, 9, 14, 14);
    }
    for (int i = 0; i < 8; i++) h[i] ^= v[i] ^ v[i + 8];
}

/* BLAKE2s with a digest of 16 bytes, RFC 7693. */
static void write_tag(const struct maglev_profile *profile, const uint8_t *data, size_t length, uint8_t *tag) {
    uint32_t h[8];
    uint8_t block[BLOCK] = {0};
    for (int i = 0; i < 8; i++) h[i] = BLAKE_START[i];
    h[0] ^= 0x01010000u ^ profile->key_length << 8 ^ TAG;
    copy_bytes(block, profile->key, profile->key_length);
    compress(h, block, BLOCK, false);
    size_t done = 0;
    for (; length - done > BLOCK; done += BLOCK) compress(h, data + done, (uint32_t)(BLOCK + done + BLOCK), false);
    for (size_t i = 0; i < BLOCK; i++) block[i] = done + i < length ? data[done + i] : 0;
    compress(h, block, (uint32_t)(BLOCK + length), true);
    for (size_t i = 0; i < TAG; i++) tag[i] = (uint8_t)(h[i / 4] >> 8 * (i % 4));
}

/* ---- frames ---- */

/* One traversal of a frame's fields both writes and reads them, little-endian. */
struct cursor { uint8_t *to; const uint8_t *from; };

static uint64_t bytes(struct cursor *c, uint64_t value, int count) {
    uint64_t found = 0;
    for (int i = 0; i < count; i++) {
        if (c->to) *c->to++ = (uint8_t)(value >> (8 * i));
        else found |= (uint64_t)*c->from++ << (8 * i);
    }
    return c->to ? value : found;
}

static void u8(struct cursor *c, uint8_t *value) { *value = (uint8_t)bytes(c, *value, 1); }
static void u16(struct cursor *c, uint16_t *value) { *value = (uint16_t)bytes(c, *value, 2); }
static void u32(struct cursor *c, uint32_t *value) { *value = (uint32_t)bytes(c, *value, 4); }
static void u64(struct cursor *c, uint64_t *value) { *value = bytes(c, *value, 8); }
static void gap(struct cursor *c, int count) { (void)bytes(c, 0, count); }
static void hash(struct cursor *c, uint8_t *value) { for (int i = 0; i < MAGLEV_HASH; i++) u8(c, &value[i]); }

static void f64(struct cursor *c, double *values, int count) {
    for (int i = 0; i < count; i++) {
        union { double value; uint64_t bits; } both = {values[i]};
        u64(c, &both.bits);
        values[i] = both.value;
    }
}

static void f32(struct cursor *c, float *values, int count) {
    for (int i = 0; i < count; i++) {
        union { float value; uint32_t bits; } both = {values[i]};
        u32(c, &both.bits);
        values[i] = both.value;
    }
}

static void walk(struct cursor *c, struct maglev_frame *f) {
    uint16_t magic = MAGIC;
    uint8_t version = MAGLEV_VERSION;
    u16(c, &magic), u8(c, &version), u8(c, &f->type), u32(c, &f->session), u32(c, &f->sequence), u64(c, &f->time);
    switch (f->type) {
    case MAGLEV_HELLO:
        /* HELLO, by make protocol */
        u64(c, &f->of.hello.nonce);
        hash(c, f->of.hello.calibration);
        /* end */
        break;
    case MAGLEV_HELLO_ACK:
        /* HELLO_ACK, by make protocol */
        u64(c, &f->of.hello_ack.nonce);
        u8(c, &f->of.hello_ack.status);
        u8(c, &f->of.hello_ack.lockstep);
        u8(c, &f->of.hello_ack.version);
        u8(c, &f->of.hello_ack.state);
        u32(c, &f->of.hello_ack.device);
        hash(c, f->of.hello_ack.calibration);
        u64(c, &f->of.hello_ack.period);
        u64(c, &f->of.hello_ack.delay);
        u64(c, &f->of.hello_ack.latency);
        u64(c, &f->of.hello_ack.watchdog);
        u64(c, &f->of.hello_ack.enable);
        u64(c, &f->of.hello_ack.stale);
        u64(c, &f->of.hello_ack.fault_time);
        u32(c, &f->of.hello_ack.faults);
        u32(c, &f->of.hello_ack.first);
        u32(c, &f->of.hello_ack.frozen);
        f64(c, &f->of.hello_ack.current_limit, 1);
        f64(c, &f->of.hello_ack.continuous_current, 1);
        f64(c, &f->of.hello_ack.hover_limit, 1);
        f64(c, &f->of.hello_ack.thermal_time, 1);
        f64(c, &f->of.hello_ack.spot_limit, 1);
        f64(c, &f->of.hello_ack.spot_speed, 1);
        u64(c, &f->of.hello_ack.wall_period);
        u64(c, &f->of.hello_ack.wall_delay);
        f64(c, &f->of.hello_ack.stiffness_limit, 1);
        f64(c, &f->of.hello_ack.damping_limit, 1);
        f64(c, &f->of.hello_ack.edge_speed, 1);
        u32(c, &f->of.hello_ack.wall_count);
        f64(c, &f->of.hello_ack.lever, 1);
        f64(c, &f->of.hello_ack.energy, 1);
        f64(c, &f->of.hello_ack.recede, 1);
        f64(c, &f->of.hello_ack.off_current, 1);
        /* end */
        break;
    case MAGLEV_CTRL:
        /* CTRL, by make protocol */
        u32(c, &f->of.ctrl.request);
        u8(c, &f->of.ctrl.operation);
        gap(c, 3), u32(c, &f->of.ctrl.faults);
        f64(c, f->of.ctrl.hover, 6);
        f64(c, f->of.ctrl.stop, 8);
        /* end */
        break;
    case MAGLEV_CTRL_ACK:
        /* CTRL_ACK, by make protocol */
        u32(c, &f->of.ctrl_ack.request);
        u8(c, &f->of.ctrl_ack.operation);
        u8(c, &f->of.ctrl_ack.result);
        u8(c, &f->of.ctrl_ack.state);
        gap(c, 1), u32(c, &f->of.ctrl_ack.faults);
        /* end */
        break;
    case MAGLEV_STATE:
        /* STATE, by make protocol */
        f64(c, f->of.state.spots, 6);
        f32(c, f->of.state.currents, 6);
        f32(c, f->of.state.temperatures, 6);
        u8(c, &f->of.state.state);
        u8(c, &f->of.state.valid);
        u16(c, &f->of.state.flags);
        u32(c, &f->of.state.faults);
        u32(c, &f->of.state.answered);
        u32(c, &f->of.state.age);
        u32(c, &f->of.state.conversions);
        /* end */
        break;
    case MAGLEV_CMD:
        /* CMD, by make protocol */
        u32(c, &f->of.cmd.answers);
        u32(c, &f->of.cmd.flags);
        f64(c, f->of.cmd.held, 6);
        f64(c, f->of.cmd.pulsed, 6);
        f64(c, &f->of.cmd.width, 1);
        /* end */
        for (struct maglev_wall *w = f->of.cmd.walls; w < f->of.cmd.walls + f->of.cmd.count; w++) {
            /* walls, by make protocol */
            u8(c, &w->axis);
            u8(c, (uint8_t *)&w->side);
            gap(c, 2), f64(c, &w->edge, 1);
            f64(c, &w->stiffness, 1);
            f64(c, &w->damping, 1);
            f64(c, &w->cutoff, 1);
            /* end */
        }
        break;
    case MAGLEV_ESTOP:
        /* ESTOP, by make protocol */
        u64(c, &f->of.estop.request);
        /* end */
        break;
    default:
        /* ESTOP_ACK, by make protocol */
        u64(c, &f->of.estop_ack.request);
        u8(c, &f->of.estop_ack.state);
        u8(c, &f->of.estop_ack.lockstep);
        gap(c, 2), u32(c, &f->of.estop_ack.faults);
        u64(c, &f->of.estop_ack.sampled);
        f32(c, f->of.estop_ack.currents, 6);
        f64(c, &f->of.estop_ack.off_current, 1);
        /* end */
    }
}

static size_t trailer(const struct maglev_profile *profile) { return CRC + (profile->key_length ? TAG : 0); }

size_t maglev_encode(const struct maglev_profile *profile, struct maglev_frame *frame, uint8_t *data) {
    struct cursor c = {data, NULL};
    size_t length = SIZES[frame->type] + (frame->type == MAGLEV_CMD ? WALL * frame->of.cmd.count : 0);
    walk(&c, frame);
    if (profile->key_length) write_tag(profile, data, length, c.to), c.to += TAG, length += TAG;
    (void)bytes(&c, crc32(data, length), CRC);
    return length + CRC;
}

enum maglev_reason maglev_decode(const struct maglev_profile *profile, const uint8_t *data, size_t length,
                                 struct maglev_frame *frame) {
    if (length < 4) return MAGLEV_SHORT;
    if (data[0] != (MAGIC & 0xFF) || data[1] != MAGIC >> 8) return MAGLEV_BAD_MAGIC;
    if (length > MAGLEV_LARGEST) return MAGLEV_BAD_LENGTH; /* before the CRC, to bound its time */
    if (length < 4 + trailer(profile)) return MAGLEV_BAD_CRC;
    struct cursor c = {NULL, data + length - CRC};
    if (bytes(&c, 0, CRC) != crc32(data, length - CRC)) return MAGLEV_BAD_CRC;
    if (data[2] != MAGLEV_VERSION) return MAGLEV_BAD_VERSION;
    if (data[3] < MAGLEV_HELLO || data[3] >= MAGLEV_TYPES) return MAGLEV_BAD_TYPE;
    size_t body = SIZES[data[3]], count = 0;
    if (data[3] == MAGLEV_CMD)
        for (; count < MAGLEV_WALLS && length > body + trailer(profile); count++) body += WALL;
    if (length != body + trailer(profile)) return MAGLEV_BAD_LENGTH;
    if (profile->key_length) {
        uint8_t tag[TAG];
        write_tag(profile, data, body, tag);
        if (!same_bytes(tag, data + body, TAG)) return MAGLEV_BAD_TAG;
    }
    c.from = data;
    if (data[3] == MAGLEV_CMD) frame->of.cmd.count = (uint32_t)count;
    walk(&c, frame);
    return MAGLEV_REASONS;
}

/* ---- serial line ---- */

size_t maglev_stuff(const uint8_t *frame, size_t length, uint8_t *out) {
    size_t code = 1, end = 2; /* index of the block's length, and of its next byte */
    out[0] = 0;
    for (size_t i = 0; i < length; i++) {
        if (frame[i]) out[end++] = frame[i];
        if (frame[i] == 0 || (end - code == 255 && i + 1 < length)) out[code] = (uint8_t)(end - code), code = end++;
    }
    out[code] = (uint8_t)(end - code);
    out[end++] = 0;
    return end;
}

static void add_byte(struct maglev_line *line, uint8_t byte) {
    if (line->length == MAGLEV_LARGEST) line->lost = true;
    else line->data[line->length++] = byte;
}

size_t maglev_unstuff(struct maglev_line *line, uint8_t byte) {
    if (byte == 0) {
        size_t length = line->lost || line->left ? 0 : line->length;
        line->length = 0, line->code = line->left = 0, line->lost = false;
        return length;
    }
    if (line->lost) return 0;
    if (line->left) {
        line->left--;
        add_byte(line, byte);
    } else {
        if (line->code && line->code != 255) add_byte(line, 0);
        line->code = byte, line->left = (uint8_t)(byte - 1);
    }
    return 0;
}

/* ---- temperatures ---- */

/* 1 - exp(-x) for x >= 0: series for x / 2^n, doubled n times. */
static double risen(double x) {
    if (!(x < 64.0)) return 1.0;
    int doublings = 0;
    for (; x > 0.015625; x *= 0.5) doublings++; /* at most 12 */
    static const double parts[7] = {1.0 / 8, 1.0 / 7, 1.0 / 6, 1.0 / 5, 1.0 / 4, 1.0 / 3, 1.0 / 2};
    double sum = 1.0;
    for (int i = 0; i < 7; i++) sum = 1.0 - sum * x * parts[i];
    sum *= x;
    for (; doublings; doublings--) sum *= 2.0 - sum;
    return sum;
}

void maglev_heat(struct maglev_device *d, double seconds, const double *currents) {
    double share = risen(seconds / d->profile->thermal_time);
    double scale = 1.0 / (d->profile->continuous_current * d->profile->continuous_current);
    d->heated = true;
    for (int i = 0; i < MAGLEV_COILS; i++) d->rises[i] += share * (scale * currents[i] * currents[i] - d->rises[i]);
    if (all_finite(d->rises)) return;
    for (int i = 0; i < MAGLEV_COILS; i++) d->rises[i] = 1.0; /* invalid measurement: trip */
}

static double warmest(const struct maglev_device *d) {
    double most = d->rises[0];
    for (int i = 1; i < MAGLEV_COILS; i++) most = d->rises[i] > most ? d->rises[i] : most;
    return most;
}

/* ---- guards ---- */

/* Fault of a command; nothing is clamped. */
static uint32_t command_fault(const struct maglev_device *d, const double *held, const double *pulsed, double width) {
    double most = d->profile->current_limit * (1.0 + ROUNDING);
    if (!all_finite(held) || !all_finite(pulsed) || !(width >= 0.0 && width <= 1.0)) return MAGLEV_INVALID_COMMAND;
    return all_within(held, most) && all_within(pulsed, most) ? 0 : MAGLEV_COIL_OVERCURRENT;
}

/* Fault of the spots, in samples with this period [ns] and number. */
static uint32_t spot_fault(const struct maglev_profile *p, struct maglev_diodes *d, const struct maglev_reading *r,
                           uint64_t period, uint32_t number) {
    bool had = d->known;
    d->known = (r->valid & 7) == 7 && all_within(r->spots, p->spot_limit);
    if (!d->known) return MAGLEV_SENSOR_OUT_OF_RANGE;
    double fastest = 0.0;
    uint32_t most = 0;
    for (int i = 0; had && i < MAGLEV_SPOTS; i++) {
        double moved = size(r->spots[i] - d->spots[i]);
        fastest = moved > fastest ? moved : fastest;
    }
    for (int k = 0; k < 3; k++) {
        bool same = had && r->spots[2 * k] == d->spots[2 * k] && r->spots[2 * k + 1] == d->spots[2 * k + 1];
        d->same[k] = same ? d->same[k] + 1 : 0;
        most = d->same[k] > most ? d->same[k] : most;
    }
    /* missed samples count as time */
    uint32_t periods = number == d->number ? 1 : number - d->number;
    double step = p->spot_speed * ((double)period * 1e-9) * (double)periods;
    copy_six(d->spots, r->spots), d->number = number;
    if (had && fastest > step) /* far above the limit: a jump of the sensor */
        return fastest < IMPLAUSIBLE * step ? MAGLEV_FLOTOR_OVERSPEED : MAGLEV_SENSOR_OUT_OF_RANGE;
    return p->frozen && most >= p->frozen ? MAGLEV_SENSOR_FROZEN : 0;
}

/* Count consecutive samples with a condition; return true at the limit. */
static bool strikes(uint8_t *count, bool so, uint8_t enough) {
    *count = so ? (uint8_t)(*count + (*count < enough)) : 0;
    return *count >= enough;
}

static bool follows(const struct maglev_reading *r, double close) {
    for (int i = 0; i < MAGLEV_COILS; i++)
        if (!(size(r->commanded[i] - r->measured[i]) <= close + CLOSE_SHARE * size(r->commanded[i]))) return false;
    return true;
}

/* Faults at a sample while currents flow, added to `fault`. */
static uint32_t flight_fault(struct maglev_device *d, const struct maglev_reading *r, uint32_t fault) {
    fault |= spot_fault(d->profile, &d->diodes, r, d->profile->period, r->number);
    if (d->has_conversions && r->conversions == d->conversions) fault |= MAGLEV_SENSOR_STOPPED;
    d->has_conversions = true, d->conversions = r->conversions;
    if (strikes(&d->not_following, !follows(r, d->profile->off_current), PATIENCE)) fault |= MAGLEV_COIL_NOT_FOLLOWING;
    if (strikes(&d->not_enabled, !r->enabled, 2)) fault |= MAGLEV_WATCHDOG;
    return fault;
}

/* Hold hover currents while commands are missing; return true after the timeout. */
static bool silent(struct maglev_device *d, uint64_t now, uint32_t fault) {
    uint64_t waited = now > d->commanded_at && !d->profile->lockstep ? now - d->commanded_at : 0;
    if (waited > d->profile->watchdog) return true;
    if (waited > GAP * d->profile->period && !d->holding && !fault) {
        d->holding = true;
        d->hardware->drive(d->hardware->context, now, d->hover, d->hover, 0.0);
    }
    return false;
}

/* ---- walls ---- */

static double multiplied(const double *row, const double *six) {
    double sum = 0.0;
    for (int i = 0; i < 6; i++) sum += row[i] * six[i];
    return sum;
}

static void locate(const struct maglev_profile *p, const double *spots, double *pose) {
    double moved[MAGLEV_SPOTS];
    for (int i = 0; i < MAGLEV_SPOTS; i++) moved[i] = spots[i] - p->spots[i];
    for (int i = 0; i < 6; i++) pose[i] = multiplied(p->pose + 6 * i, moved);
}

static void forget_walls(struct maglev_device *d) {
    d->walled = d->has_next = d->has_pose = d->seen.known = false;
    d->count = d->next_count = d->receding = 0, d->energy = d->stored = 0.0;
    for (int i = 0; i < MAGLEV_WALLS; i++) d->wall_speeds[i] = d->wall_forces[i] = 0.0;
}

static double lever_of(const struct maglev_profile *p, const struct maglev_wall *w) {
    return w->axis < 3 ? 1.0 : p->lever;
}

static bool alike(const struct maglev_wall *one, const struct maglev_wall *other) {
    return one->axis == other->axis && one->side == other->side;
}

/* True if the stiffness or damping of wall `i` is not below 0, and its sum with that of the walls before it that push the
   same way along the axis is within the limit. A wall on both sides pushes both ways. */
static bool bounded(const struct maglev_wall *walls, uint32_t i, bool damping, double limit) {
    if (!((damping ? walls[i].damping : walls[i].stiffness) >= 0.0)) return false;
    for (int push = -1; push <= 1; push += 2) {
        double sum = 0.0;
        for (const struct maglev_wall *w = walls; walls[i].side != -push && w <= walls + i; w++)
            if (w->axis == walls[i].axis && w->side != -push) sum += damping ? w->damping : w->stiffness;
        if (!(sum <= limit)) return false;
    }
    return true;
}

/* True if the device can render these walls: together within its limits, no edge faster than `edge_speed` in `periods`
   or, of a new wall, more than a period of that around the flotor. */
static bool renders(const struct maglev_device *d, const struct maglev_wall *w, uint32_t count, uint32_t periods) {
    const struct maglev_profile *p = d->profile;
    const struct maglev_wall *known = d->has_next ? d->next : d->walls;
    uint32_t all = d->has_next ? d->next_count : d->count;
    double pose[6];
    if (!count) return true;
    if (!p->wall_period || count > p->wall_count || !d->diodes.known) return false;
    locate(p, d->diodes.spots, pose);
    for (uint32_t i = 0; i < count; i++, w++) {
        if (w->axis >= 6 || w->side < -1 || w->side > 1) return false;
        double lever = lever_of(p, w);
        if (!bounded(w - i, i, false, p->stiffness_limit * lever * lever)) return false;
        if (!bounded(w - i, i, true, p->damping_limit * lever * lever)) return false;
        if (!finite(w->edge) || !(w->cutoff >= 0.0 && finite(w->cutoff))) return false;
        double step = p->edge_speed * ((double)p->period * 1e-9) * (1.0 + ROUNDING) / lever;
        double depth = w->edge - pose[w->axis], moved = w->side ? w->side * depth : size(depth);
        if (i < all && alike(w, known + i)) moved = size(w->edge - known[i].edge), step *= (double)periods;
        if (!(moved <= step)) return false;
    }
    return true;
}

/* Let the pending walls take effect; a wall on the same axis and side continues. */
static void switch_walls(struct maglev_device *d) {
    for (uint32_t i = 0; i < d->next_count; i++) {
        if (i >= d->count || !alike(d->walls + i, d->next + i)) d->wall_speeds[i] = d->wall_forces[i] = 0.0;
        d->walls[i] = d->next[i];
    }
    d->count = d->next_count, d->has_next = false;
}

/* Replace the walls after `delay`; those still pending take effect now, but for those of the same answer, repeated. */
static void command_walls(struct maglev_device *d, const struct maglev_frame *f, uint64_t now) {
    if (!f->of.cmd.count && !d->walled) return;
    uint64_t due = now + d->profile->delay;
    if (d->has_next && due > d->due) switch_walls(d);
    double lift = d->stop[7] > 1.0 ? d->stop[7] : 1.0;
    for (int i = 0; i < MAGLEV_COILS; i++) { /* largest currents of the host, or without it */
        double most = size(f->of.cmd.held[i]), other = size(f->of.cmd.pulsed[i]), own = size(lift * d->hover[i]);
        most = other > most ? other : most, most = own > most ? own : most;
        d->peaks[0][i] = d->walled ? d->peaks[!d->has_next][i] : most, d->peaks[1][i] = most;
    }
    for (uint32_t i = 0; i < f->of.cmd.count; i++) d->next[i] = f->of.cmd.walls[i];
    d->next_count = f->of.cmd.count, d->due = due, d->has_next = d->walled = true;
}

/* Currents of the walls at a sample. Inside f = -K (x - edge) - B v. While commands are missing a wall on both sides
   has no stiffness: it would pull to where its edge was. In a controlled stop the edges recede, counted in samples, as
   the clock may be what failed. A sample that is not later than the last one has no speed: the currents stay. */
static void render(struct maglev_device *d, uint64_t now, const double *spots, double *currents) {
    const struct maglev_profile *p = d->profile;
    double pose[6], forces[6] = {0.0}, share = 1.0;
    if (d->has_next && now >= d->due) switch_walls(d);
    if (d->has_pose && now <= d->wall_sampled) {
        d->wall_sampled = now; /* of a clock that was set back: the next sample is later */
        copy_six(currents, d->wall_currents);
        return;
    }
    locate(p, spots, pose);
    if (!d->has_pose) copy_six(d->pose, pose);
    double elapsed = (double)(d->has_pose ? now - d->wall_sampled : p->wall_period) * 1e-9;
    double receded = p->recede * ((double)d->receding * (double)p->wall_period * 1e-9);
    d->receding += d->stopping;
    double surplus = d->energy - d->stored;
    d->energy -= (surplus > 0.0 ? surplus : 0.0) * elapsed / MEMORY, d->stored = 0.0;
    for (uint32_t i = 0; i < d->count; i++) {
        const struct maglev_wall *w = d->walls + i;
        double edge = w->edge - w->side * (receded / lever_of(p, w)), x = pose[w->axis], old = d->pose[w->axis];
        double stiffness = (d->holding || d->stopping) && !w->side ? 0.0 : w->stiffness;
        double moved = x - old, first = old - edge, offset = x - edge, speed = moved / elapsed;
        if (w->cutoff > 0.0)
            speed = d->wall_speeds[i] + risen(TWO_PI * w->cutoff * elapsed) * (speed - d->wall_speeds[i]);
        bool inside = w->side * offset <= 0.0;
        double stored = inside ? 0.5 * stiffness * offset * offset : 0.0;
        d->stored += stored, d->energy += d->wall_forces[i] * moved + stored;
        d->energy -= w->side * first <= 0.0 ? 0.5 * stiffness * first * first : 0.0;
        d->wall_speeds[i] = speed, d->wall_forces[i] = inside ? -(stiffness * offset + w->damping * speed) : 0.0;
        forces[w->axis] += d->wall_forces[i];
    }
    d->energy = d->energy > 0.0 ? d->energy : 0.0;
    copy_six(d->pose, pose), d->wall_sampled = now, d->has_pose = true;
    for (int i = 0; i < MAGLEV_COILS; i++) {
        currents[i] = multiplied(p->current + 6 * i, forces);
        double room = p->current_limit - (d->peaks[0][i] > d->peaks[1][i] ? d->peaks[0][i] : d->peaks[1][i]);
        room = room > 0.0 ? room : 0.0;
        if (size(currents[i]) > room && room / size(currents[i]) < share) share = room / size(currents[i]);
    }
    if (share < 1.0) { /* reduced together, so that the direction stays */
        for (int i = 0; i < MAGLEV_COILS; i++) currents[i] *= share;
        for (int i = 0; i < MAGLEV_WALLS; i++) d->wall_forces[i] *= share;
    }
    copy_six(d->wall_currents, currents);
    if (!d->count && !d->has_next) forget_walls(d);
}

/* ---- states ---- */

static void cut(struct maglev_device *d) {
    d->hardware->cut(d->hardware->context);
    d->holding = d->stopping = false;
    forget_walls(d);
}

/* Latch faults, and cut the currents; if `soft`, by a controlled stop if currents flow. */
static void latch(struct maglev_device *d, uint32_t faults, uint64_t now, bool soft) {
    bool flying = d->state == MAGLEV_ACTIVE && (d->holding || d->answers != MAGLEV_NONE);
    if (soft && flying && d->stop[6] > 0.0) {
        d->stopping = true, d->holding = false, d->stopped = d->number;
        d->hardware->drive(d->hardware->context, now, d->hover, d->hover, 0.0);
    } else if (!(soft && d->stopping)) cut(d);
    if (d->state != MAGLEV_FAULT) d->fault_time = now, d->first = faults;
    d->state = MAGLEV_FAULT, d->faults |= faults;
}

/* Controlled stop: fade the hover currents out, counted in samples, as the clock may be what failed, and damp the motion
   along the lift by the spots alone. */
static void descend(struct maglev_device *d, uint64_t now, const double *before, uint32_t steps) {
    double elapsed = (double)(d->number - d->stopped) * (double)d->profile->period * 1e-9, motion = 0.0;
    double currents[MAGLEV_COILS];
    if (!(elapsed < d->stop[6])) {
        cut(d);
        return;
    }
    for (int i = 0; i < MAGLEV_SPOTS; i++) motion += d->stop[i] * (d->diodes.spots[i] - before[i]);
    double seconds = (double)(steps ? steps : 1) * (double)d->profile->period * 1e-9;
    double scale = 1.0 - elapsed / d->stop[6] - motion / seconds;
    scale = !(scale > 0.0) ? 0.0 : scale < d->stop[7] ? scale : d->stop[7]; /* 0 for NaN, too */
    for (int i = 0; i < MAGLEV_COILS; i++) currents[i] = scale * d->hover[i];
    d->hardware->drive(d->hardware->context, now, currents, currents, 0.0);
}

void maglev_trip(struct maglev_device *d, uint32_t faults) {
    latch(d, faults, d->hardware->now(d->hardware->context), false);
}

void maglev_lose_host(struct maglev_device *d) {
    if (d->state == MAGLEV_ACTIVE || d->stopping) maglev_trip(d, MAGLEV_WATCHDOG);
    d->session = 0, d->peer = 0;
}

static bool arm(struct maglev_device *d, const double *hover, const double *stop, uint64_t now) {
    if (d->state != MAGLEV_INACTIVE || !all_within(hover, d->profile->hover_limit)) return false;
    if (!all_finite(stop) || !(stop[6] >= 0.0 && stop[6] <= LONGEST_STOP)) return false;
    if (!(stop[7] >= 0.0 && finite(stop[7]))) return false;
    for (int i = 0; i < MAGLEV_COILS; i++)
        if (!(size(stop[7] * hover[i]) <= d->profile->continuous_current)) return false;
    copy_six(d->hover, hover), copy_six(d->stop, stop), d->stop[6] = stop[6], d->stop[7] = stop[7];
    d->commanded_at = now, d->answers = MAGLEV_NONE, d->newest = d->number;
    d->holding = d->diodes.known = d->has_conversions = false;
    d->not_following = d->not_off = d->not_enabled = 0;
    d->state = MAGLEV_ACTIVE;
    d->hardware->toggle(d->hardware->context, now);
    return true;
}

static bool reset(struct maglev_device *d) {
    bool off = d->state != MAGLEV_ACTIVE && !d->stopping && all_within(d->measured, d->profile->off_current);
    if (!off || !(warmest(d) < WARNING_RISE)) return false;
    d->state = MAGLEV_INACTIVE, d->faults = d->first = 0, d->fault_time = 0;
    return true;
}

static bool perform(struct maglev_device *d, const struct maglev_frame *f, uint64_t now) {
    uint32_t known = f->of.ctrl.faults & MAGLEV_ALL_FAULTS;
    switch (f->of.ctrl.operation) {
    case MAGLEV_TRIP: latch(d, known ? known : MAGLEV_HOST, now, !(known & ~(uint32_t)SOFT)); return true;
    case MAGLEV_RESET: return reset(d);
    case MAGLEV_ARM: return arm(d, f->of.ctrl.hover, f->of.ctrl.stop, now);
    case MAGLEV_DISARM: case MAGLEV_BYE:
        if (d->state == MAGLEV_ACTIVE || d->stopping) cut(d);
        if (d->state == MAGLEV_ACTIVE) d->state = MAGLEV_INACTIVE;
        return true;
    default: return false;
    }
}

/* ---- session ---- */

static size_t ignore(struct maglev_device *d, enum maglev_reason reason) {
    d->counts[reason]++;
    return 0;
}

static size_t greet(struct maglev_device *d, uint64_t now, uint64_t nonce, uint8_t status, uint8_t *answer) {
    const struct maglev_profile *p = d->profile;
    struct maglev_frame f = {MAGLEV_HELLO_ACK, status == MAGLEV_WELCOME ? d->session : 0, 0, now, .of.hello_ack = {
        .nonce = nonce, .status = status, .version = MAGLEV_VERSION, .state = d->state,
        .fault_time = d->fault_time, .faults = d->faults, .first = d->first,
        /* properties, by make protocol */
        .lockstep = p->lockstep,
        .device = p->device,
        .period = p->period,
        .delay = p->delay,
        .latency = p->latency,
        .watchdog = p->watchdog,
        .enable = p->enable,
        .stale = p->stale,
        .frozen = p->frozen,
        .current_limit = p->current_limit,
        .continuous_current = p->continuous_current,
        .hover_limit = p->hover_limit,
        .thermal_time = p->thermal_time,
        .spot_limit = p->spot_limit,
        .spot_speed = p->spot_speed,
        .wall_period = p->wall_period,
        .wall_delay = p->wall_delay,
        .stiffness_limit = p->stiffness_limit,
        .damping_limit = p->damping_limit,
        .edge_speed = p->edge_speed,
        .wall_count = p->wall_count,
        .lever = p->lever,
        .energy = p->energy,
        .recede = p->recede,
        .off_current = p->off_current,
        /* end */
    }};
    copy_bytes(f.of.hello_ack.calibration, p->calibration, MAGLEV_HASH);
    return maglev_encode(p, &f, answer);
}

static size_t hello(struct maglev_device *d, const struct maglev_frame *f, uint64_t now, uint64_t peer,
                    uint8_t *answer) {
    uint64_t nonce = f->of.hello.nonce;
    if (!(d->session && nonce == d->nonce && peer == d->peer)) { /* else the earlier answer was lost */
        if (d->session && (d->state == MAGLEV_ACTIVE || now < d->heard + SILENCE))
            return ignore(d, MAGLEV_BUSY_HELLO), greet(d, now, nonce, MAGLEV_BUSY, answer);
        if (!same_bytes(f->of.hello.calibration, d->profile->calibration, MAGLEV_HASH))
            return greet(d, now, nonce, MAGLEV_OTHER_CALIBRATION, answer);
        d->session = d->hardware->random(d->hardware->context);
        d->session += d->session == 0;
        d->nonce = nonce, d->peer = peer, d->heard = now, d->sequence = 0, d->last.any = false;
        d->is_answered = false, d->answers = MAGLEV_NONE;
    }
    return greet(d, now, nonce, MAGLEV_WELCOME, answer);
}

static size_t control(struct maglev_device *d, const struct maglev_frame *f, uint64_t now, uint8_t *answer) {
    if (!d->last.any || f->of.ctrl.request != d->last.request) {
        if (d->last.any && !newer(f->of.ctrl.request, d->last.request)) return ignore(d, MAGLEV_OLD);
        d->heard = now;
        d->last.request = f->of.ctrl.request, d->last.operation = f->of.ctrl.operation;
        d->last.result = perform(d, f, now) ? MAGLEV_DONE : MAGLEV_REFUSED;
        d->last.any = true;
    }
    struct maglev_frame a = {MAGLEV_CTRL_ACK, d->session, 0, now, .of.ctrl_ack = {
        d->last.request, d->last.operation, d->last.result, d->state, d->faults}};
    if (d->last.operation == MAGLEV_BYE) d->session = 0, d->peer = 0;
    return maglev_encode(d->profile, &a, answer);
}

static size_t obey(struct maglev_device *d, const struct maglev_frame *f, uint64_t now) {
    if (!newer(f->sequence, d->sequence)) return ignore(d, MAGLEV_OLD);
    d->sequence = f->sequence, d->heard = now;
    /* wraps to a huge age for a future sample */
    uint64_t age = (uint64_t)(d->number - f->of.cmd.answers) * d->profile->period;
    if (!d->profile->lockstep && now > d->sampled) age += now - d->sampled;
    if (age > (d->profile->lockstep ? 0 : d->profile->stale)) return ignore(d, MAGLEV_OLD);
    d->is_answered = true, d->answered = f->of.cmd.answers;
    if (d->state == MAGLEV_INACTIVE) /* lets a host measure link latency before takeoff */
        d->commanded_at = now, d->answers = f->of.cmd.answers;
    if (d->state != MAGLEV_ACTIVE) return ignore(d, MAGLEV_NOT_ACTIVE);
    uint32_t fault = command_fault(d, f->of.cmd.held, f->of.cmd.pulsed, f->of.cmd.width);
    /* an answer to an older sample moves no edge, nor is the time before it counted again */
    uint32_t newest = newer(f->of.cmd.answers, d->newest) ? f->of.cmd.answers : d->newest;
    if (!fault && !renders(d, f->of.cmd.walls, f->of.cmd.count, newest - d->newest)) fault = MAGLEV_INVALID_COMMAND;
    if (fault) return latch(d, fault, now, true), 0;
    command_walls(d, f, now);
    d->commanded_at = now, d->answers = f->of.cmd.answers, d->newest = newest, d->holding = false;
    d->hardware->drive(d->hardware->context, now, f->of.cmd.held, f->of.cmd.pulsed, f->of.cmd.width);
    return 0;
}

static size_t emergency(struct maglev_device *d, const struct maglev_frame *f, uint64_t now, uint8_t *answer) {
    latch(d, MAGLEV_ESTOPPED, now, false);
    struct maglev_frame a = {MAGLEV_ESTOP_ACK, 0, 0, now, .of.estop_ack = {
        .request = f->of.estop.request, .state = d->state, .lockstep = d->profile->lockstep, .faults = d->faults,
        .sampled = d->sampled, .off_current = d->profile->off_current}};
    for (int i = 0; i < MAGLEV_COILS; i++) a.of.estop_ack.currents[i] = single(d->measured[i]);
    return maglev_encode(d->profile, &a, answer);
}

static bool positive(double value) { return finite(value) && value > 0.0; }

/* Consistency of the profile: see HELLO_ACK in the protocol. Times first, so
   that twice a period does not overflow. */
static bool agree(const struct maglev_profile *p) {
    return p->lockstep <= 1 && p->watchdog <= LONGEST && p->period <= p->watchdog / 2 && p->delay <= 2 * p->period &&
           p->enable <= p->watchdog && p->stale >= p->period && p->stale <= p->watchdog &&
           p->hover_limit <= p->continuous_current && p->continuous_current <= p->current_limit &&
           p->off_current <= p->continuous_current && p->latency <= 2 * p->period && p->wall_count <= MAGLEV_WALLS &&
           (p->wall_period ? p->period % p->wall_period == 0 : !p->wall_delay) &&
           p->wall_delay <= 2 * p->wall_period && finite(p->stiffness_limit) && p->stiffness_limit >= 0.0 &&
           finite(p->damping_limit) && p->damping_limit >= 0.0 && finite(p->edge_speed) && p->edge_speed >= 0.0 &&
           finite(p->recede) && p->recede >= 0.0;
}

bool maglev_start(struct maglev_device *d, const struct maglev_profile *p, const struct maglev_hardware *h) {
    bool key = p->key_length == 0 || (p->key_length >= 16 && p->key_length <= MAGLEV_KEY);
    if (!key || !p->period || !p->enable || !positive(p->current_limit) ||
        !positive(p->continuous_current) || !positive(p->hover_limit) || !positive(p->thermal_time) ||
        !positive(p->spot_limit) || !positive(p->spot_speed) || !positive(p->lever) ||
        !positive(p->energy) || !positive(p->off_current) || !agree(p) ||
        !h->read || !h->drive || !h->cut || !h->toggle || !h->now || !h->random ||
        (p->wall_period && !h->add)) return false;
    for (size_t i = 0; i < sizeof *d; i++) ((uint8_t *)d)[i] = 0;
    d->profile = p, d->hardware = h, d->answers = MAGLEV_NONE;
    cut(d);
    return true;
}

size_t maglev_receive(struct maglev_device *d, const uint8_t *data, size_t length, uint64_t peer, uint8_t *answer) {
    struct maglev_frame f;
    uint64_t now = d->hardware->now(d->hardware->context);
    enum maglev_reason reason = maglev_decode(d->profile, data, length, &f);
    if (reason != MAGLEV_REASONS) {
        ignore(d, reason);
        bool other = reason == MAGLEV_BAD_VERSION && data[3] == MAGLEV_HELLO;
        return other ? greet(d, now, 0, MAGLEV_OTHER_VERSION, answer) : 0;
    }
    if (f.type == MAGLEV_ESTOP) return emergency(d, &f, now, answer);
    if (f.type == MAGLEV_HELLO) return hello(d, &f, now, peer, answer);
    if (f.type != MAGLEV_CTRL && f.type != MAGLEV_CMD) return ignore(d, MAGLEV_DIRECTION);
    if (!d->session || f.session != d->session || peer != d->peer) return ignore(d, MAGLEV_SESSION);
    return f.type == MAGLEV_CTRL ? control(d, &f, now, answer) : obey(d, &f, now);
}

static size_t report(struct maglev_device *d, const struct maglev_reading *r, bool stopping, uint8_t *data) {
    struct maglev_frame f = {MAGLEV_STATE, d->session, r->number, r->time, .of.state = {
        .state = d->state, .valid = r->valid, .faults = d->faults, .answered = d->answers, .age = MAGLEV_NONE,
        .flags = (uint16_t)((d->holding ? MAGLEV_HOLDING : 0) | (r->enabled ? MAGLEV_ENABLED : 0) |
                            (stopping ? MAGLEV_STOPPING : 0)),
        .conversions = r->conversions}};
    copy_six(f.of.state.spots, r->spots);
    for (int i = 0; i < MAGLEV_COILS; i++) {
        f.of.state.currents[i] = single(r->measured[i]);
        f.of.state.temperatures[i] = single(d->rises[i]);
    }
    if (d->answers != MAGLEV_NONE) {
        uint64_t age = r->time > d->commanded_at ? (r->time - d->commanded_at) / 1000 : 0;
        f.of.state.age = age < MAGLEV_NONE ? (uint32_t)age : MAGLEV_NONE - 1;
    }
    return maglev_encode(d->profile, &f, data);
}

size_t maglev_sample(struct maglev_device *d, uint8_t *data) {
    struct maglev_reading r = {0};
    d->hardware->read(d->hardware->context, &r);
    double before[MAGLEV_SPOTS];
    uint32_t steps = r.number - d->number;
    if (!d->heated && d->has_sampled)
        maglev_heat(d, (double)steps * (double)d->profile->period * 1e-9, r.measured);
    copy_six(before, d->diodes.known ? d->diodes.spots : r.spots);
    d->heated = false, d->has_sampled = true, d->number = r.number, d->sampled = r.time;
    copy_six(d->measured, r.measured);
    uint32_t fault = warmest(d) < 1.0 ? 0 : MAGLEV_COIL_OVERTEMP;
    if (d->state == MAGLEV_ACTIVE || d->stopping) fault = flight_fault(d, &r, fault);
    else if (strikes(&d->not_off, !all_within(r.measured, d->profile->off_current), PATIENCE)) fault |= MAGLEV_COIL_NOT_OFF;
    bool stopping = d->stopping, lost = d->state == MAGLEV_ACTIVE && silent(d, r.time, fault);
    if (fault || lost) latch(d, fault | (lost ? MAGLEV_WATCHDOG : 0), r.time, !fault);
    stopping |= d->stopping; /* also where it ends: these currents were measured before */
    if (d->stopping) descend(d, r.time, before, steps);
    if (d->state == MAGLEV_ACTIVE || d->stopping) /* last, in case the step hangs */
        d->hardware->toggle(d->hardware->context, r.time);
    return d->session ? report(d, &r, stopping, data) : 0;
}

void maglev_wall(struct maglev_device *d) {
    struct maglev_reading r = {0};
    double currents[MAGLEV_COILS] = {0.0};
    if (!d->walled || !(d->state == MAGLEV_ACTIVE || d->stopping)) return;
    d->hardware->read(d->hardware->context, &r);
    uint32_t fault = spot_fault(d->profile, &d->seen, &r, d->profile->wall_period, d->seen.number + 1);
    if (fault) {
        latch(d, fault, r.time, false);
        return;
    }
    render(d, r.time, r.spots, currents);
    d->hardware->add(d->hardware->context, r.time, currents);
    if (!(d->energy - d->stored > d->profile->energy)) return;
    forget_walls(d);
    for (int i = 0; i < MAGLEV_COILS; i++) currents[i] = 0.0;
    d->hardware->add(d->hardware->context, r.time, currents);
    latch(d, MAGLEV_WALL_ENERGY, r.time, true);
}
