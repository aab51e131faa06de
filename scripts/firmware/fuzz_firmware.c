/* Feed mutated frames to the firmware and check invariants after each.

       cc -std=c99 -g -O1 -fsanitize=address,undefined -fno-sanitize-recover=all scripts/firmware/fuzz_firmware.c
          scripts/firmware/maglev_firmware.c -o fuzz_firmware
       fuzz_firmware [FRAMES [SEED]]      1 000 000 without a key and as many with one, by default
       fuzz_firmware -max_len=8192 CORPUS    libFuzzer, if compiled with clang -fsanitize=fuzzer,address,undefined

   Exit status 1 if a current flows outside ACTIVE or exceeds its limit, an answer is too long, or the enable line is
   toggled outside ACTIVE; sanitizers abort on memory and arithmetic errors. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "maglev_firmware.h"

enum { COILS = MAGLEV_COILS };
#define PERIOD UINT64_C(5000000)

static struct maglev_device device;
static struct maglev_profile profile = {
    .period = PERIOD, .delay = 1500000, .watchdog = 10 * PERIOD, .enable = 3 * PERIOD, .stale = 4 * PERIOD,
    .hover_limit = 1.5, .frozen = 20, .device = 1, .wall_period = PERIOD / 5, .wall_delay = 200000,
    /* limits, by make protocol */
    .current_limit = 10.0,
    .continuous_current = 3.0,
    .thermal_time = 10.0,
    .spot_limit = 0.0209,
    .spot_speed = 1.0,
    .stiffness_limit = 100000.0,
    .damping_limit = 400.0,
    .edge_speed = 0.1,
    .wall_count = 12,
    .lever = 0.03,
    .energy = 0.004,
    .recede = 0.03,
    .off_current = 0.25,
    /* end */
    .pose = {[0] = 1.0, [7] = 1.0, [14] = 1.0, [21] = 1.0, [28] = 1.0, [35] = 1.0},
    .current = {[0] = 0.5, [7] = 0.5, [14] = 0.5, [21] = 0.5, [28] = 0.5, [35] = 0.5}};
static uint64_t now, state_of_random;
static const uint8_t *input; /* numbers are drawn from its bytes; null: at random */
static size_t left;
static uint32_t number;
static double flowing[COILS], added[COILS], peak[COILS];
static unsigned long done, driven, flights, stopped, pushed;

static uint64_t draw(uint64_t below) { /* bytes of the input, or xorshift64* */
    uint64_t value = 0;
    for (uint64_t most = below - 1; input && left && most; most >>= 8) value = value << 8 | *input++, left--;
    if (input) return value % below;
    state_of_random ^= state_of_random >> 12, state_of_random ^= state_of_random << 25;
    state_of_random ^= state_of_random >> 27;
    return (state_of_random * UINT64_C(2685821657736338717) >> 11) % below;
}

static void require(int so, const char *what) {
    if (so) return;
    fprintf(stderr, "fuzz_firmware: after %lu frames: %s\n", done, what);
    exit(1);
}

static double number_at_random(void) {
    static const double odd[] = {0.0, -0.0, 10.0, -10.0, 10.00000002, 1.5, 1.500001, 5e-324, 1e308, -1e308, 0.001, 1.0};
    union { uint64_t bits; double value; } any = {draw(2) ? draw(UINT64_MAX) : draw(8) << 61 | 0x7FF0000000000000};
    return draw(20) ? (double)draw(1000) * 0.001 : draw(2) ? odd[draw(sizeof odd / sizeof *odd)] : any.value;
}

static void read_sample(void *context, struct maglev_reading *r) {
    (void)context;
    r->time = now, r->number = number, r->conversions = number - (draw(300) == 0), r->valid = draw(300) ? 7 : 5;
    r->enabled = draw(50) != 0;
    for (int i = 0; i < 6; i++) {
        r->spots[i] = draw(500) ? 1e-6 * (double)draw(2000) : number_at_random();
        r->commanded[i] = flowing[i], r->measured[i] = draw(500) ? flowing[i] : number_at_random();
    }
}

static void drive(void *context, uint64_t at, const double *held, const double *pulsed, double width) {
    (void)context, (void)at;
    require(device.state == MAGLEV_ACTIVE || device.stopping, "driven although currents are cut");
    require(width >= 0.0 && width <= 1.0, "a pulse of another width");
    for (int i = 0; i < COILS; i++) {
        double most = 10.0 * (1.0 + 1e-9);
        require(held[i] >= -most && held[i] <= most && pulsed[i] >= -most && pulsed[i] <= most, "beyond the limit");
        flowing[i] = held[i];
        peak[i] = held[i] * held[i] > pulsed[i] * pulsed[i] ? held[i] : pulsed[i];
    }
    driven++;
}

static void add(void *context, uint64_t at, const double *currents) {
    (void)context, (void)at;
    require(device.state == MAGLEV_ACTIVE || device.stopping, "walls although currents are cut");
    for (int i = 0; i < COILS; i++) {
        double sum = (peak[i] < 0.0 ? -peak[i] : peak[i]) + (currents[i] < 0.0 ? -currents[i] : currents[i]);
        require(sum <= 10.0 * (1.0 + 1e-9) || currents[i] == 0.0, "walls beyond the limit");
        added[i] = currents[i], pushed += currents[i] != 0.0;
    }
}

static void cut(void *context) {
    (void)context;
    memset(flowing, 0, sizeof flowing), memset(added, 0, sizeof added);
}

static void toggle(void *context, uint64_t at) {
    (void)context, (void)at;
    require(device.state == MAGLEV_ACTIVE || device.stopping, "toggled although currents are cut");
}

static uint64_t device_now(void *context) {
    (void)context;
    return now;
}

static uint32_t draw_session(void *context) {
    (void)context;
    return (uint32_t)draw(4) * 0x40000001u;
}

static const struct maglev_hardware hardware = {NULL, read_sample, drive, add, cut, toggle, device_now, draw_session};

static void fill(struct maglev_frame *f) {
    static const uint8_t usual[] = {MAGLEV_CMD, MAGLEV_CMD, MAGLEV_CMD, MAGLEV_CTRL, MAGLEV_CTRL};
    f->type = draw(20) ? usual[draw(sizeof usual)] : (uint8_t)(1 + draw(MAGLEV_TYPES - 1));
    if (!device.session) f->type = MAGLEV_HELLO;
    f->session = f->type == MAGLEV_CTRL || f->type == MAGLEV_CMD ? device.session : 0;
    f->sequence = device.sequence + (draw(20) ? 1 : (uint32_t)draw(UINT32_MAX));
    f->time = draw(UINT64_MAX);
    switch (f->type) {
    case MAGLEV_HELLO: f->of.hello.nonce = draw(20) == 0; break; /* calibration: all zeros */
    case MAGLEV_CTRL:
        f->of.ctrl.request = device.last.request + (draw(10) ? 1 : (uint32_t)draw(3) - 1);
        f->of.ctrl.operation = draw(8) ? device.state == MAGLEV_INACTIVE ? MAGLEV_ARM : MAGLEV_RESET : (uint8_t)draw(8);
        f->of.ctrl.faults = (uint32_t)draw(UINT32_MAX);
        for (int i = 0; i < COILS; i++) f->of.ctrl.hover[i] = number_at_random();
        for (int i = 0; i < MAGLEV_STOP; i++) f->of.ctrl.stop[i] = number_at_random();
        break;
    case MAGLEV_CMD:
        f->of.cmd.answers = number - (draw(10) ? 0 : (uint32_t)draw(14) - 1);
        for (int i = 0; i < COILS; i++) {
            f->of.cmd.held[i] = draw(10) ? 0.5 : number_at_random();
            f->of.cmd.pulsed[i] = draw(10) ? 0.5 : number_at_random();
        }
        f->of.cmd.width = draw(10) ? 0.001 : number_at_random();
        f->of.cmd.count = (uint32_t)(draw(2) * draw(MAGLEV_WALLS + 1)); /* half have none */
        for (uint32_t i = 0; i < f->of.cmd.count; i++) {
            bool odd = draw(200) == 0;
            f->of.cmd.walls[i] = (struct maglev_wall){odd ? 6 : (uint8_t)(i % 6), (int8_t)draw(3) - 1,
                odd ? number_at_random() : 1e-3, odd ? number_at_random() : 10.0, 1e-3, draw(2) ? 0.0 : 200.0};
        }
        break;
    default: break; /* unchanged */
    }
}

static void turn_bits(void *start, size_t length) {
    for (uint64_t flips = 1 + draw(4); flips; flips--) ((uint8_t *)start)[draw(length)] ^= (uint8_t)(1u << draw(8));
}

static void seal(uint8_t *data, size_t body) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t bit = 0; bit < 8 * body; bit++) {
        if (bit % 8 == 0) crc ^= data[bit / 8];
        crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    for (int i = 0; i < 4; i++) data[body + (size_t)i] = (uint8_t)(~crc >> 8 * i);
}

/* Flip bits of a frame's fields, or of its bytes with or without a new CRC, or truncate it. */
static size_t make(uint8_t *data) {
    struct maglev_frame f = {.type = 0};
    uint64_t kind = draw(12);
    fill(&f);
    if (kind == 0) turn_bits(draw(4) ? (void *)&f.of : (void *)&f.session, draw(4) ? 8 : sizeof f.of);
    if (f.type == MAGLEV_CMD) f.of.cmd.count %= MAGLEV_WALLS + 1;
    size_t length = maglev_encode(&profile, &f, data);
    if (kind == 1 || kind == 2) turn_bits(data, draw(3) ? length : 4);
    if (kind == 3) length = draw(length + 1);
    if ((kind == 1 || kind == 3) && length > 8) data[0] = 'M', data[1] = 'J', seal(data, length - 4);
    return length;
}

static void look(size_t length) {
    require(length <= MAGLEV_LARGEST, "an answer longer than it may be");
    require(device.state <= MAGLEV_FAULT && (device.faults != 0) == (device.state == MAGLEV_FAULT), "a state that is none");
    require(!device.stopping || device.state == MAGLEV_FAULT, "a controlled stop outside FAULT");
    for (int i = 0; i < COILS && device.stopping; i++)
        require(flowing[i] >= -3.0 && flowing[i] <= 3.0, "more than the continuous current in a controlled stop");
    for (int i = 0; i < COILS && device.state != MAGLEV_ACTIVE && !device.stopping; i++)
        require(flowing[i] == 0.0 && added[i] == 0.0, "a current after a cut");
}

/* Frame, then perhaps a sample. Exact lengths, so that a sanitizer detects every access beyond them. */
static void feed(const uint8_t *data, size_t length) {
    uint8_t *answer = malloc(MAGLEV_LARGEST), *exact = malloc(length ? length : 1), before = device.state;
    require(answer && exact, "no memory");
    memcpy(exact, data, length);
    now += draw(PERIOD / 4);
    look(maglev_receive(&device, exact, length, draw(50) ? 0 : draw(3), answer));
    flights += before == MAGLEV_INACTIVE && device.state == MAGLEV_ACTIVE;
    if (draw(3) == 0) {
        number += draw(100) ? 1 : (uint32_t)draw(15), now += PERIOD;
        before = device.state;
        look(maglev_sample(&device, answer));
        for (int i = 0; i < 4 && device.walled; i++) now += PERIOD / 5, maglev_wall(&device), look(0);
        stopped += before == MAGLEV_ACTIVE && device.state != MAGLEV_ACTIVE;
    }
    if (draw(5000) == 0) memset(device.rises, 0, sizeof device.rises), now += UINT64_C(2000000000); /* it cools */
    free(exact), free(answer);
}

static void run(uint32_t key_length, unsigned long count) {
    uint8_t data[MAGLEV_LARGEST];
    profile.key_length = key_length;
    for (int i = 0; i < MAGLEV_KEY; i++) profile.key[i] = (uint8_t)i;
    memset(&device, 0, sizeof device);
    require(maglev_start(&device, &profile, &hardware), "it does not start");
    for (unsigned long end = done + count; done < end && (left || !input); done++) feed(data, make(data));
}

/* Bytes of a serial line: each frame gets the session and a valid CRC. */
static void hear(const uint8_t *data, size_t size) {
    struct maglev_line line = {.length = 0};
    run(0, 0);
    for (; size; data++, size--) {
        size_t length = maglev_unstuff(&line, *data);
        if (length > 24) memcpy(line.data + 4, &device.session, 4), seal(line.data, length - 4);
        if (length) feed(line.data, length), done++;
    }
}

/* libFuzzer's entry: the first byte selects the frames that are drawn, without a key or with one, or a serial line. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (!size) return 0;
    now = number = 0, state_of_random = 1;
    input = *data % 3 < 2 ? data + 1 : NULL, left = size - 1;
    if (input) run(*data % 3 ? MAGLEV_KEY : 0, left);
    else hear(data + 1, left);
    return 0;
}

__attribute__((weak)) int main(int count, char **arguments) { /* libFuzzer has its own */
    unsigned long each = count > 1 ? strtoul(arguments[1], NULL, 10) : 1000000;
    state_of_random = (count > 2 ? strtoul(arguments[2], NULL, 10) : 1) * 2 + 1;
    run(0, each);
    run(MAGLEV_KEY, each);
    printf("%lu frames, %lu flights, %lu commands driven, %lu flights ended by a guard at a sample, %lu wall currents\n",
           done, flights, driven, stopped, pushed);
    for (int i = 0; i < MAGLEV_REASONS; i++)
        printf("%s %lu%s", maglev_reasons[i], (unsigned long)device.counts[i], i + 1 < MAGLEV_REASONS ? ", " : "\n");
    uint8_t bytes[4096];
    done = flights = 0;
    for (unsigned long i = 0; i < each / 50; i++) {
        for (size_t k = 0; k < sizeof bytes; k++) bytes[k] = (uint8_t)(rand() >> 8);
        LLVMFuzzerTestOneInput(bytes, sizeof bytes);
    }
    printf("%lu frames of random inputs, %lu flights\n", done, flights);
    return 0;
}
