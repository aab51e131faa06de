/* Simulated device with the firmware: UDP on 127.0.0.1, a clock, an amplifier board, and a flotor for small angles.

       cd scripts/firmware
       cc -std=c99 -O2 simulated_device.c simulated_flotor.c maglev_queue.c maglev_firmware.c -o simulated_device -lm
       simulated_device --plant FILE [--port 0] [--rate 200] [--delay 0.0015] [--watchdog 0.05] [--enable SECONDS]
                        [--stale SECONDS] [--wall-rate 1000] [--wall-delay 0.0002] [--hover-limit 3] [--noise 0] [--lockstep] [--calibration-hash HEX32]
                        [--key FILE] [--device 1] [--seconds 0] [--fault NAME:K@SECONDS]
                        [--hand X,Y,Z,RX,RY,RZ@FROM:UNTIL]
       simulated_device --golden [--key FILE] < FRAMES

   The plant FILE contains seven names, each followed by its numbers: wrench_per_current (36, row-major) [N/A, N m/A],
   inertia (6: mass three times, then moments) [kg, kg m^2], gravity (6: accelerations) [m/s^2, rad/s^2],
   spots_per_pose (36, row-major) [1, m], rest (6) [m, rad], and the inverses pose_per_spot and current_per_wrench.
   Then come limits of the device by name, in the units of HELLO_ACK; others are those of the published joystick. A key
   FILE has 32 to 64 hexadecimal digits. --noise is the amplitude of the spot noise [m]; with it 30 consecutive equal readings are a fault. --golden reads frames, one line of
   hexadecimal digits each, and prints them re-encoded. Faults are listed in FAULTS below. --hand applies a constant
   wrench [N, N m] to the flotor between two times of the device's clock [s]. */
#define _POSIX_C_SOURCE 200809L

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "maglev_queue.h"
#include "simulated_flotor.h"

#define AGAIN UINT64_C(20000000)       /* [ns]; lockstep: an unanswered STATE is repeated after this time, then at double intervals */
#ifndef LET_GO
#define LET_GO UINT64_C(2000000000)    /* [ns]; lockstep: the host is dropped after this time */
#endif

enum { WAITING = 4096 };
static const struct { const char *name; int count; } FAULTS[NO_FAULT] = {
    {"dead-coil", COILS}, {"stuck-amplifier", COILS}, {"stuck-diode", 3}, {"invalid-diode", 3}, {"stuck-diodes", 1},
    {"stuck-counter", 1}};

static void fail(const char *what, const char *name) {
    fprintf(stderr, "simulated_device: %s: %s\n", what, name);
    exit(2);
}

struct plant plant = {.fault = NO_FAULT, .random = 1};
struct maglev_device device;
struct maglev_profile profile = {
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
};

void render(void) { maglev_wall(&device); }

uint32_t draw(void *context) {
    uint32_t number = 0;
    FILE *source = fopen("/dev/urandom", "rb");
    (void)context;
    if (!source || fread(&number, sizeof number, 1, source) != 1) fail("cannot be read", "/dev/urandom");
    fclose(source);
    return number;
}

/* ---- socket and clock ---- */

static volatile sig_atomic_t ended;
static int line; /* the socket */
static uint64_t begun;

static void end(int number) { (void)number, ended = 1; }

static uint64_t clock_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

/* A peer is encoded as address and port. A frame that cannot be sent is dropped. */
static void send_to(uint64_t peer, const uint8_t *data, size_t length) {
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = (in_port_t)peer};
    to.sin_addr.s_addr = (in_addr_t)(peer >> 16);
    if (length) (void)!sendto(line, data, length, 0, (const struct sockaddr *)&to, sizeof to);
}

static void answer(void *context, uint64_t peer, const uint8_t *data, size_t length) {
    (void)context;
    send_to(peer, data, length);
}

static size_t next_frame(void *context, uint8_t *data, uint64_t *peer) {
    struct sockaddr_in from;
    socklen_t size = sizeof from;
    ssize_t length = recvfrom(line, data, MAGLEV_LARGEST + 1, 0, (struct sockaddr *)&from, &size);
    (void)context;
    if (length < 0) return 0; /* no more, or an error of an earlier datagram */
    *peer = (uint64_t)from.sin_addr.s_addr << 16 | from.sin_port;
    return length ? (size_t)length : 1; /* an empty one is too short, too */
}

/* Time of the machine, to which the plant advances; frames after the next sample's due time count at that time. */
static uint64_t frame_clock(void *context) {
    uint64_t now = clock_now(), due = ((uint64_t)plant.number + 1) * profile.period;
    (void)context;
    if (!profile.lockstep) advance(now - begun < due ? now - begun : due);
    return now;
}

static struct maglev_waiting frames[WAITING];
static struct maglev_queue queue = {NULL, next_frame, answer, frame_clock, frames, WAITING, 0, 0, 0, 0};

/* Wait for frames until a time of the machine's clock, or only for that time once they have had theirs; process them. */
static void hear(uint64_t until) {
    bool rests = maglev_rests(&device, &queue);
    uint64_t now = clock_now(), left = until > now && (rests || !queue.count) ? until - now : 0;
    struct timespec wait = {(time_t)(left / 1000000000u), (long)(left % 1000000000u)};
    fd_set ready;
    FD_ZERO(&ready);
    if (!rests) FD_SET(line, &ready);
    (void)pselect(line + 1, &ready, NULL, NULL, &wait, NULL);
    maglev_serve(&device, &queue);
}

/* Simulated time waits for the answer to each sample; without a host it stands still. */
static void in_lockstep(uint64_t stop) {
    uint8_t data[MAGLEV_LARGEST];
    while (!ended && clock_now() < stop) {
        while (!device.session && !ended && clock_now() < stop) hear(clock_now() + AGAIN);
        if (!device.session) return;
        plant.number++;
        advance((uint64_t)plant.number * profile.period);
        uint32_t session = device.session;
        size_t length = maglev_sample(&device, data);
        uint64_t sent = clock_now(), again = sent, step = AGAIN;
        while (!ended && device.session == session && !(device.is_answered && device.answered == plant.number)) {
            if (clock_now() >= again) send_to(device.peer, data, length), again = sent + step, step *= 2;
            hear(again);
            if (clock_now() - sent > LET_GO) maglev_lose_host(&device);
        }
    }
}

/* Samples are due at whole periods; those that were missed are left out, never caught up. */
static void in_real_time(uint64_t stop) {
    uint8_t data[MAGLEV_LARGEST];
    while (!ended && clock_now() < stop) {
        uint64_t due = begun + ((uint64_t)plant.number + 1) * profile.period;
        do hear(due); while (!ended && clock_now() < due);
        plant.number += (uint32_t)((clock_now() - due) / profile.period + 1);
        advance((uint64_t)plant.number * profile.period);
        size_t length = maglev_sample(&device, data);
        send_to(device.peer, data, length);
    }
}

/* ---- arguments ---- */

static const struct { const char *name; double *place; } LIMITS[] = {
    /* places of limits, by make protocol */
    {"current_limit", &profile.current_limit},
    {"continuous_current", &profile.continuous_current},
    {"thermal_time", &profile.thermal_time},
    {"spot_limit", &profile.spot_limit},
    {"spot_speed", &profile.spot_speed},
    {"stiffness_limit", &profile.stiffness_limit},
    {"damping_limit", &profile.damping_limit},
    {"edge_speed", &profile.edge_speed},
    {"lever", &profile.lever},
    {"energy", &profile.energy},
    {"recede", &profile.recede},
    {"off_current", &profile.off_current},
    /* end */
};

/* Read the plant: its maps in a fixed order, then the limits of the device by name; others keep their default. */
static void read_plant(const char *path) {
    static const char *const names[] = {"wrench_per_current", "inertia", "gravity", "spots_per_pose", "rest",
                                        "pose_per_spot", "current_per_wrench"};
    double *const places[] = {plant.wrench, plant.inertia, plant.gravity, plant.slopes, plant.rest, profile.pose,
                              profile.current};
    FILE *file = fopen(path, "r");
    if (!file) fail("cannot be read", path);
    for (int i = 0; i < 7; i++) {
        char name[32];
        if (fscanf(file, "%31s", name) != 1 || strcmp(name, names[i]))
            fail("not in its place in the plant's file", names[i]);
        for (int k = 0; k < (i == 0 || i == 3 || i > 4 ? 36 : 6); k++)
            if (fscanf(file, "%lf", &places[i][k]) != 1 || !isfinite(places[i][k]))
                fail("too few numbers, or one that is none", names[i]);
    }
    char name[32];
    while (fscanf(file, "%31s", name) == 1) {
        size_t k = 0, count = sizeof LIMITS / sizeof *LIMITS;
        while (k < count && strcmp(name, LIMITS[k].name)) k++;
        if (k == count || fscanf(file, "%lf", LIMITS[k].place) != 1) fail("no such limit, or no number", name);
    }
    fclose(file);
    for (int i = 0; i < 6; i++)
        if (!(plant.inertia[i] > 0.0)) fail("must be above 0", names[1]);
    lay();
}

/* Return the number of bytes of hexadecimal digits; 0 if they are invalid or exceed the buffer. */
static uint32_t read_hex(uint8_t *place, uint32_t room, const char *text) {
    size_t digits = strspn(text, "0123456789abcdefABCDEF");
    if (text[digits] || digits % 2 || digits > 2 * room) return 0;
    for (size_t i = 0; i < digits / 2; i++) {
        char pair[] = {text[2 * i], text[2 * i + 1], 0};
        place[i] = (uint8_t)strtoul(pair, NULL, 16);
    }
    return (uint32_t)(digits / 2);
}

static void read_key(const char *path) {
    char text[72] = "";
    FILE *file = fopen(path, "r");
    if (!file) fail("cannot be read", path);
    int found = fscanf(file, "%71s", text);
    fclose(file);
    profile.key_length = read_hex(profile.key, MAGLEV_KEY, text);
    if (found != 1 || profile.key_length < 16) fail("must have 32 to 64 hexadecimal digits", path);
}

static void read_fault(const char *text) {
    char name[32];
    double at;
    int last = 0;
    if (sscanf(text, "%31[a-z-]:%d@%lf%n", name, &plant.which, &at, &last) != 3 || text[last] || !(at >= 0.0))
        fail("must be NAME:K@SECONDS", text);
    for (plant.fault = 0; plant.fault < NO_FAULT && strcmp(name, FAULTS[plant.fault].name);) plant.fault++;
    if (plant.fault == NO_FAULT || plant.which < 0 || plant.which >= FAULTS[plant.fault].count)
        fail("no such fault", text);
    plant.fault_at = (uint64_t)(at * 1e9);
}

static uint64_t nanoseconds(double seconds) { return (uint64_t)(seconds * 1e9 + 0.5); }

static void read_hand(const char *text) {
    double *hand = plant.hand, from, until;
    int last = 0, found = sscanf(text, "%lf,%lf,%lf,%lf,%lf,%lf@%lf:%lf%n", hand, hand + 1, hand + 2, hand + 3,
                                 hand + 4, hand + 5, &from, &until, &last);
    if (found != 8 || text[last] || !(from >= 0.0) || !(until >= from) || !(until < 1e9))
        fail("must be X,Y,Z,RX,RY,RZ@FROM:UNTIL", text);
    plant.hand_from = nanoseconds(from), plant.hand_until = nanoseconds(until);
}

static int golden(void) {
    char text[2 * MAGLEV_LARGEST + 2];
    while (fgets(text, sizeof text, stdin)) {
        text[strcspn(text, "\n")] = 0;
        uint8_t data[MAGLEV_LARGEST];
        struct maglev_frame frame;
        if (maglev_decode(&profile, data, read_hex(data, sizeof data, text), &frame) != MAGLEV_REASONS)
            fail("no frame", text);
        size_t length = maglev_encode(&profile, &frame, data);
        for (size_t k = 0; k < length; k++) printf("%02x", data[k]);
        printf("\n");
    }
    return 0;
}

static void listen_on(uint16_t port) {
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(port)};
    socklen_t size = sizeof address;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    line = socket(AF_INET, SOCK_DGRAM, 0);
    if (line < 0 || bind(line, (struct sockaddr *)&address, size) ||
        getsockname(line, (struct sockaddr *)&address, &size) || fcntl(line, F_SETFL, O_NONBLOCK))
        fail("cannot listen", strerror(errno));
    printf("listening udp://127.0.0.1:%u\n", ntohs(address.sin_port));
    fflush(stdout);
}

int main(int count, char **arguments) {
    enum { PORT, RATE, DELAY, WATCHDOG, ENABLE, STALE, HOVER, NOISE, DEVICE, SECONDS, WALLS, LATE, NUMBERS };
    struct { const char *name; double value, least, most; } numbers[NUMBERS] = {
        {"--port", 0.0, 0.0, 65535.0}, {"--rate", 200.0, 1.0, 1e5}, {"--delay", 0.0015, 0.0, 0.1},
        {"--watchdog", 0.05, 0.001, 1.0}, {"--enable", 0.0, 0.0, 1.0}, {"--stale", 0.0, 0.0, 1.0},
        {"--hover-limit", 3.0, 0.001, 10.0}, {"--noise", 0.0, 0.0, 0.001}, {"--device", 1.0, 0.0, 4294967295.0},
        {"--seconds", 0.0, 0.0, 1e6}, {"--wall-rate", 1000.0, 0.0, 1e5}, {"--wall-delay", 0.0002, 0.0, 0.1}};
    const char *plant_file = NULL;
    int only_golden = 0;
    char rest;
    for (int i = 1, k; i < count; i += 2) {
        const char *name = arguments[i], *value = i + 1 < count ? arguments[i + 1] : "";
        for (k = 0; k < NUMBERS && strcmp(name, numbers[k].name);) k++;
        if (!strcmp(name, "--lockstep")) profile.lockstep = true, i--;
        else if (!strcmp(name, "--golden")) only_golden = 1, i--;
        else if (!strcmp(name, "--plant")) plant_file = value;
        else if (!strcmp(name, "--key")) read_key(value);
        else if (!strcmp(name, "--fault")) read_fault(value);
        else if (!strcmp(name, "--hand")) read_hand(value);
        else if (!strcmp(name, "--calibration-hash")) {
            if (read_hex(profile.calibration, MAGLEV_HASH, value) != MAGLEV_HASH)
                fail("must be 32 hexadecimal digits", name);
        } else if (k == NUMBERS) fail("no such argument", name);
        else if (sscanf(value, "%lf%c", &numbers[k].value, &rest) != 1 || !(numbers[k].value >= numbers[k].least) ||
                 !(numbers[k].value <= numbers[k].most)) fail("not a number that is allowed", name);
    }
    if (only_golden) return golden();
    if (!plant_file) fail("needed", "--plant FILE");
    read_plant(plant_file);
    plant.noise = numbers[NOISE].value;
    profile.period = nanoseconds(1.0 / numbers[RATE].value), profile.delay = nanoseconds(numbers[DELAY].value);
    profile.watchdog = nanoseconds(numbers[WATCHDOG].value), profile.enable = nanoseconds(numbers[ENABLE].value);
    if (!profile.enable) { /* 3 periods or 10 ms, and at most the watchdog */
        profile.enable = 3 * profile.period > 10000000 ? 3 * profile.period : 10000000;
        if (profile.enable > profile.watchdog) profile.enable = profile.watchdog;
    }
    profile.stale = nanoseconds(numbers[STALE].value);
    if (!profile.stale) { /* 4 periods, and at most the watchdog */
        profile.stale = 4 * profile.period;
        if (profile.stale > profile.watchdog) profile.stale = profile.watchdog;
    }
    if (numbers[WALLS].value > 0.0) { /* the nearest whole fraction of the period that divides it */
        uint64_t count = (uint64_t)(numbers[WALLS].value / numbers[RATE].value + 0.5);
        for (count += count == 0; profile.period % count;) count--;
        profile.wall_period = profile.period / count, profile.wall_delay = nanoseconds(numbers[LATE].value);
        if (profile.wall_delay > 2 * profile.wall_period) profile.wall_delay = 2 * profile.wall_period;
    }
    profile.hover_limit = numbers[HOVER].value, profile.device = (uint32_t)numbers[DEVICE].value;
    profile.frozen = plant.noise > 0.0 ? 30 : 0;
    if (!maglev_start(&device, &profile, &hardware)) fail("no device is like this", "profile");

    struct sigaction action = {.sa_handler = end};
    sigaction(SIGTERM, &action, NULL), sigaction(SIGINT, &action, NULL);
    listen_on((uint16_t)numbers[PORT].value);
    begun = clock_now();
    uint64_t stop = numbers[SECONDS].value > 0.0 ? begun + nanoseconds(numbers[SECONDS].value) : UINT64_MAX;
    (profile.lockstep ? in_lockstep : in_real_time)(stop);
    for (int i = 0; i < MAGLEV_REASONS; i++)
        printf("%s %lu%s", maglev_reasons[i], (unsigned long)device.counts[i], i + 1 < MAGLEV_REASONS ? ", " : "\n");
    close(line);
    return 0;
}
