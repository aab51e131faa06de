/* Program of a device: samples by TIM3, commanded currents by TIM5, those of walls by TIM4, the firmware in one loop. */
#include "board.h"
#include "chip.h"
#include "device.h" /* written by build.py */
#include "own.h"

enum { COILS = MAGLEV_COILS, STEPS = 16, INTERVALS = 16 };
enum { CURRENTS = 0, SAMPLES = 1 }; /* interrupt priorities, both before that of bytes */

struct step { uint64_t at; double currents[COILS]; };
/* Changes of the currents of commands or of walls, soonest first, and what flows now. */
struct queue { struct timer *timer; int waiting; struct step steps[STEPS]; double flowing[COILS]; };

struct maglev_profile profile = {PROFILE};

static struct queue commands = {.timer = TIM5}, walls = {.timer = TIM4};
static struct maglev_reading latched; /* by the sample timer */
static volatile uint32_t ticks;       /* of that timer, since the start */
static uint64_t started, switched;    /* its start; last change of the currents, or sample [ns] */
static struct { double seconds, currents[COILS]; } intervals[INTERVALS]; /* of constant current, to heat the coils */
static volatile uint32_t begun, heated;
static uint32_t done; /* ticks that the loop has seen */

static void copy(double *to, const double *from) {
    for (int i = 0; i < COILS; i++) to[i] = from[i];
}

static uint64_t sample_period(void) { return profile.wall_period ? profile.wall_period : profile.period; }

/* ---- currents; called without interrupts ---- */

static void end_interval(uint64_t time) {
    if (begun - heated < INTERVALS) {
        intervals[begun % INTERVALS].seconds = (double)(time - switched) * 1e-9;
        copy(intervals[begun % INTERVALS].currents, latched.commanded), begun++;
    }
    switched = time;
}

static void flow(void) {
    end_interval(clock_now());
    for (int i = 0; i < COILS; i++) latched.commanded[i] = commands.flowing[i] + walls.flowing[i];
    own_currents(latched.commanded);
}

/* Let the queue's timer interrupt at its first step; the 16-bit timer of the walls counts microseconds. */
static void wake(struct queue *queue) {
    uint64_t time = clock_now(), at = queue->waiting ? queue->steps[0].at : 0, left = at > time ? at - time : 0;
    uint32_t count = (uint32_t)(queue->timer == TIM5 ? left * TIMER_MHZ / 1000 : left / 1000);
    queue->timer->cr1 = 0, queue->timer->cnt = 0, queue->timer->sr = 0, queue->timer->arr = count ? count : 1;
    if (queue->waiting) queue->timer->cr1 = RUNS | ONE_PULSE;
}

/* Add a step in place of all later ones. */
static void change(struct queue *queue, uint64_t at, const double *currents) {
    while (queue->waiting && queue->steps[queue->waiting - 1].at >= at) queue->waiting--;
    if (queue->waiting == STEPS) queue->waiting--;
    queue->steps[queue->waiting].at = at, copy(queue->steps[queue->waiting++].currents, currents);
}

static void take_step(struct queue *queue) {
    uint32_t before = masked();
    queue->timer->sr = 0;
    if (queue->waiting) {
        copy(queue->flowing, queue->steps[0].currents), queue->waiting--;
        for (int i = 0; i < queue->waiting; i++) queue->steps[i] = queue->steps[i + 1];
        flow(), wake(queue);
    }
    restore(before);
}

static void clear(struct queue *queue) {
    queue->waiting = 0, wake(queue);
    for (int i = 0; i < COILS; i++) queue->flowing[i] = 0.0;
}

/* ---- interrupts ---- */

void command_timer(void) { take_step(&commands); }
void wall_timer(void) { take_step(&walls); }

/* A sample of the walls, and every so many one of the period. */
void sample_timer(void) {
    uint32_t before = masked();
    TIM3->sr = 0;
    if (!ticks++) started = switched = clock_now() - sample_period();
    latched.time = started + ticks * sample_period(); /* the timers have one clock */
    own_read(&latched);
    end_interval(clock_now());
    restore(before);
}

/* ---- hardware functions for the firmware ---- */

static uint32_t samples_of_walls(void) { return (uint32_t)(profile.period / sample_period()); }

static void read_sample(void *context, struct maglev_reading *reading) {
    uint32_t before = masked();
    (void)context;
    *reading = latched, reading->number = ticks / samples_of_walls();
    restore(before);
}

static void drive(void *context, uint64_t now, const double *held, const double *pulsed, double width) {
    uint64_t at = now + profile.delay, pulse = (uint64_t)(width * 1e9 + 0.5);
    uint32_t before = masked();
    (void)context;
    if (pulse) change(&commands, at, pulsed);
    change(&commands, at + pulse, held), wake(&commands);
    restore(before);
}

static void add(void *context, uint64_t now, const double *currents) {
    uint32_t before = masked();
    (void)context;
    change(&walls, now + profile.wall_delay, currents), wake(&walls);
    restore(before);
}

static void cut(void *context) {
    uint32_t before = masked();
    (void)context;
    clear(&commands), clear(&walls), flow();
    restore(before);
}

static void toggle(void *context, uint64_t now) {
    (void)context, (void)now;
    own_toggle();
}

static uint64_t device_now(void *context) {
    uint32_t before = masked();
    uint64_t time = clock_now();
    (void)context;
    restore(before);
    return time;
}

static const struct maglev_hardware hardware = {NULL, read_sample, drive, add, cut, toggle, device_now, draw};

static void run(void) {
    uint8_t frame[MAGLEV_LARGEST];
    uint32_t newest = ticks, before = counts();
    if (newest == done) return;
    for (; heated != begun; heated++)
        maglev_heat(&device, intervals[heated % INTERVALS].seconds, intervals[heated % INTERVALS].currents);
    bool whole = newest / samples_of_walls() != done / samples_of_walls();
    size_t length = whole ? maglev_sample(&device, frame) : 0;
    if (device.walled) maglev_wall(&device);
    if (length) send(frame, length);
    if (counts() - before > most.sample) most.sample = counts() - before;
    done = newest, spent = 0;
}

int main(void) {
    uint64_t period = sample_period();
    own_start();
    start_line();
    if (!chip_random() && !chip_random()) return 1; /* no session numbers without the generator */
    if (period % 1000 || period > 65000000 || !maglev_start(&device, &profile, &hardware)) return 1;
    TIM3->psc = TIM4->psc = TIMER_MHZ - 1, TIM3->arr = (uint32_t)(period / 1000) - 1;
    TIM3->egr = TIM4->egr = TIM5->egr = UPDATES, TIM3->sr = TIM4->sr = TIM5->sr = 0;
    TIM3->dier = TIM4->dier = TIM5->dier = UPDATES;
    enable(TIM5_IRQ, CURRENTS), enable(TIM4_IRQ, CURRENTS), enable(TIM3_IRQ, SAMPLES);
    TIM3->cr1 = RUNS;
    for (;;) {
        hear(sample_period());
        run();
        uint32_t before = masked();
        if (came.tail == came.head && ticks == done) sleep(); /* until an interrupt, a pending one too */
        restore(before);
    }
}
