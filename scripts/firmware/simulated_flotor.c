/* See simulated_flotor.h. Freestanding, like the firmware; time in nanoseconds, motion exact between switches. */
#include "simulated_flotor.h"

static void copy_six(double *to, const double *from) {
    for (int i = 0; i < 6; i++) to[i] = from[i];
}

static bool suffers(int fault) { return plant.fault == fault && plant.now >= plant.fault_at; }

/* Currents from now on; the board passes none while its enable line is still, whatever is commanded. */
const double *flow(void) {
    const double *told = plant.now < plant.on.pulse_end ? plant.on.pulsed : plant.on.held;
    for (int i = 0; i < COILS; i++)
        plant.flowing[i] = plant.now < plant.live_until ? told[i] + plant.added.currents[i] : 0.0;
    if (suffers(DEAD_COIL)) plant.flowing[plant.which] = 0.0;
    if (suffers(STUCK_AMPLIFIER)) plant.flowing[plant.which] = plant.kept;
    plant.kept = plant.flowing[plant.which];
    return plant.flowing;
}

static void move(double duration) {
    const double *currents = flow();
    bool pushed = plant.now >= plant.hand_from && plant.now < plant.hand_until;
    double pull[6];
    maglev_heat(&device, duration, currents);
    for (int i = 0; i < 6; i++) {
        double wrench = pushed ? plant.hand[i] : 0.0;
        for (int j = 0; j < COILS; j++) wrench += plant.wrench[6 * i + j] * currents[j];
        pull[i] = wrench / plant.inertia[i] + plant.gravity[i];
    }
    if (plant.lying && !(pull[2] > 0.0)) return;
    plant.lying = 0;
    for (int i = 0; i < 6; i++) {
        plant.pose[i] += duration * (plant.twist[i] + 0.5 * duration * pull[i]);
        plant.twist[i] += duration * pull[i];
    }
    if (plant.pose[2] <= plant.rest[2] && plant.twist[2] <= 0.0) { /* it lands and stays there */
        plant.pose[2] = plant.rest[2], plant.lying = 1;
        for (int i = 0; i < 6; i++) plant.twist[i] = 0.0;
    }
}

void lay(void) {
    copy_six(plant.pose, plant.rest);
    plant.lying = 1;
}

static uint64_t sooner(uint64_t next, uint64_t event) { return plant.now < event && event < next ? event : next; }

void advance(uint64_t now) {
    for (;;) {
        while (plant.waiting && plant.due[0].at <= plant.now) {
            plant.on = plant.due[0];
            plant.waiting--;
            for (int i = 0; i < plant.waiting; i++) plant.due[i] = plant.due[i + 1];
        }
        while (plant.extras && plant.adding[0].at <= plant.now) {
            plant.added = plant.adding[0];
            plant.extras--;
            for (int i = 0; i < plant.extras; i++) plant.adding[i] = plant.adding[i + 1];
        }
        if (plant.now >= now) return;
        if (device.walled && plant.rendered <= plant.now) { /* the walls' clock runs from time 0 on */
            if (plant.now % profile.wall_period == 0) render();
            plant.rendered = (plant.now / profile.wall_period + 1) * profile.wall_period;
            continue;
        }
        uint64_t next = sooner(sooner(now, plant.live_until), plant.on.pulse_end);
        next = sooner(sooner(next, plant.hand_from), plant.hand_until);
        if (plant.waiting) next = sooner(next, plant.due[0].at);
        if (plant.extras) next = sooner(next, plant.adding[0].at);
        if (device.walled) next = sooner(next, plant.rendered);
        move((double)(next - plant.now) * 1e-9);
        plant.now = next;
    }
}

/* ---- hardware functions for the firmware ---- */

static double jitter(void) { /* uniform in -1 to 1 */
    plant.random ^= plant.random << 13, plant.random ^= plant.random >> 17, plant.random ^= plant.random << 5;
    return (double)plant.random / 2147483648.0 - 1.0;
}

static void read_sample(void *context, struct maglev_reading *r) {
    (void)context;
    r->time = plant.now, r->number = plant.number, r->valid = 7, r->enabled = plant.now <= plant.live_until;
    if (!suffers(STUCK_COUNTER)) plant.conversions++;
    r->conversions = plant.conversions;
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j < 6; j++) r->spots[i] += plant.slopes[6 * i + j] * plant.pose[j];
        if (plant.noise > 0.0) r->spots[i] += plant.noise * jitter();
        bool stuck = suffers(STUCK_DIODES) || (suffers(STUCK_DIODE) && i / 2 == plant.which);
        if (stuck && plant.has_stuck) r->spots[i] = plant.stuck[i];
    }
    if (!plant.has_stuck) copy_six(plant.stuck, r->spots);
    plant.has_stuck = suffers(STUCK_DIODES) || suffers(STUCK_DIODE);
    if (suffers(INVALID_DIODE)) r->valid &= (uint8_t)~(1 << plant.which);
    copy_six(r->commanded, plant.now < plant.on.pulse_end ? plant.on.pulsed : plant.on.held);
    for (int i = 0; i < COILS; i++) r->commanded[i] += plant.added.currents[i];
    copy_six(r->measured, flow());
}

static void drive(void *context, uint64_t now, const double *held, const double *pulsed, double width) {
    uint64_t at = now + profile.delay;
    (void)context;
    while (plant.waiting && plant.due[plant.waiting - 1].at >= at) plant.waiting--;
    if (plant.waiting == SWITCHES) plant.waiting--; /* queue full: the newest command replaces the last */
    struct drive *next = &plant.due[plant.waiting++];
    next->at = at, next->pulse_end = at + (uint64_t)(width * 1e9 + 0.5);
    copy_six(next->held, held);
    copy_six(next->pulsed, pulsed);
}

static void add(void *context, uint64_t now, const double *currents) {
    (void)context;
    if (plant.extras == EXTRAS) plant.extras--;
    plant.adding[plant.extras].at = now + profile.wall_delay;
    copy_six(plant.adding[plant.extras++].currents, currents);
}

static void cut(void *context) {
    (void)context;
    plant.waiting = plant.extras = 0;
    plant.on = (struct drive){0}, plant.added = (struct extra){0};
}

static void toggle(void *context, uint64_t now) {
    (void)context;
    plant.live_until = now + profile.enable;
}

static uint64_t device_now(void *context) {
    (void)context;
    return plant.now;
}

const struct maglev_hardware hardware = {NULL, read_sample, drive, add, cut, toggle, device_now, draw};
