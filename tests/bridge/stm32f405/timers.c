/* Turns the timers of device.c, and says when which currents flow, what heats the coils, and which samples are taken. */
#include <stdio.h>
#include <stdlib.h>

#include "board.h"
#include "chip.h"
#include "own.h"

struct timer timers[3];
struct maglev_device device;
struct ring came, leaving;
struct most most;

static uint64_t time;
static const struct maglev_hardware *hardware;
static int scene, naps, taken;
static uint64_t next_sample;

/* ---- in place of chip, board and firmware ---- */

uint32_t counts(void) { return (uint32_t)time; }
uint64_t clock_now(void) { return time; }
uint32_t chip_random(void) { return 1; }
uint32_t draw(void *context) { return (void)context, 1; }
void start_line(void) {}
uint64_t spent;
void hear(uint64_t period) { (void)period; }
void send(const uint8_t *frame, size_t length) { (void)frame, (void)length; }
void enable(int irq, uint8_t priority) { (void)irq, (void)priority; }
bool maglev_start(struct maglev_device *d, const struct maglev_profile *p, const struct maglev_hardware *h) {
    (void)d, (void)p;
    hardware = h;
    return true;
}
void maglev_heat(struct maglev_device *d, double seconds, const double *currents) {
    (void)d;
    printf("heat %.0f %g\n", seconds * 1e9, currents[0]);
}
void maglev_wall(struct maglev_device *d) {
    struct maglev_reading r = {0};
    double extra[6] = {0.5};
    (void)d;
    hardware->read(hardware->context, &r);
    hardware->add(hardware->context, r.time, extra);
    printf("wall %llu\n", (unsigned long long)r.time);
}
void own_start(void) {}
void own_read(struct maglev_reading *r) { r->valid = 7; }
void own_toggle(void) {}
void own_currents(const double *amperes) { printf("flow %llu %g\n", (unsigned long long)time, amperes[0]); }

/* A command at every sample: what the scene says. */
size_t maglev_sample(struct maglev_device *d, uint8_t *frame) {
    struct maglev_reading r = {0};
    double held[6] = {0}, pulsed[6] = {0};
    (void)frame;
    hardware->read(hardware->context, &r);
    printf("sample %u %llu\n", r.number, (unsigned long long)r.time);
    taken++;
    held[0] = taken, pulsed[0] = 10.0 + taken;
    d->walled = scene == 2 && taken < 3;
    if (scene == 3 && taken == 3) hardware->cut(hardware->context);
    else hardware->drive(hardware->context, r.time, held, pulsed, scene == 1 ? 4e-3 : 0.0);
    return 0;
}

/* Let time pass to the next interrupt. */
void sleep(void) {
    uint64_t at = next_sample ? next_sample : (uint64_t)(TIM3->arr + 1) * 1000;
    struct timer *first = TIM3;
    static uint64_t due[3];
    for (int i = 1; i < 3; i++) { /* a started timer has cnt 0 */
        struct timer *one = &timers[i];
        if (!(one->cr1 & RUNS)) { due[i] = 0; continue; }
        uint64_t length = i == 2 ? (uint64_t)one->arr * 1000 / TIMER_MHZ : (uint64_t)one->arr * 1000;
        if (!one->cnt) due[i] = time + length, one->cnt = 1;
        if (due[i] < at) at = due[i], first = one;
    }
    time = at;
    if (++naps > 60) exit(0);
    if (first == TIM3) next_sample = time + (uint64_t)(TIM3->arr + 1) * 1000, sample_timer();
    else first->cr1 &= ~(uint32_t)RUNS, first == TIM5 ? command_timer() : wall_timer();
}

int device_main(void);
int main(void) {
    scene = atoi(getenv("SCENE"));
    return device_main();
}
