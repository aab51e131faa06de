/* Program of an emulated board: the simulated flotor on the chip, in lockstep, and a log. */
#include "board.h"
#include "device.h" /* written by build.py */
#include "simulated_flotor.h"

#define AGAIN UINT64_C(20000000)    /* [ns]; an unanswered STATE is repeated after this time, then at double intervals */

struct plant plant = {PLANT, .fault = NO_FAULT, .random = 1};
struct maglev_profile profile = {PROFILE};

/* ---- log: a line for each change of state, faults or current flow ---- */

static void print(const char *text) {
    for (; *text; text++) log_byte((uint8_t)*text);
}

static void say(const char *name, uint64_t number) {
    char digits[24], *next = digits + sizeof digits;
    *--next = 0;
    do *--next = (char)('0' + number % 10), number /= 10; while (number);
    print(name), print(next);
}

static void tell(void) {
    static uint32_t known;
    const double *currents = flow();
    bool flows = false;
    for (int i = 0; i < COILS; i++) flows |= currents[i] != 0.0;
    uint32_t all = device.faults << 4 | (uint32_t)device.state << 2 | (uint32_t)flows << 1 | 1;
    if (all == known) return;
    known = all;
    say("us ", plant.now / 1000), say(" number ", plant.number), say(" state ", device.state);
    say(" faults ", device.faults), say(" flows ", flows);
    say(" sample ", most.sample), say(" command ", most.command), say(" frame ", most.frame);
    say(" wall ", most.wall), say(" lost ", most.lost), say(" again ", most.again);
    say(" stack ", stack_used()), print("\n");
}

/* ---- samples ---- */

void render(void) {
    uint32_t before = begin();
    maglev_wall(&device);
    note(&most.wall, before);
}

static void run(void) {
    static uint8_t frame[MAGLEV_LARGEST];
    static size_t length;
    static uint64_t first, last; /* first and last transmission */
    static uint32_t session;     /* of that frame */
    uint64_t now = clock_now();
    if (!device.session) return;
    if (device.session != session || (device.is_answered && device.answered == plant.number)) {
        session = device.session, first = last = now, plant.number++;
        advance((uint64_t)plant.number * profile.period);
        uint32_t before = begin();
        length = maglev_sample(&device, frame);
        note(&most.sample, before);
        send(frame, length);
    } else if (now - first > LET_GO) maglev_lose_host(&device);
    else if (now - last >= (last > first ? last - first : AGAIN)) last = now, most.again++, send(frame, length);
}

int main(void) {
    lay();
    start_line();
    if (!maglev_start(&device, &profile, &hardware)) return 1;
    for (;;) {
        hear(profile.period);
        run();
        tell();
        __asm__ volatile("cpsid i");
        if (came.tail == came.head) __asm__ volatile("wfi"); /* also wakes for pending interrupts */
        __asm__ volatile("cpsie i");
    }
}
