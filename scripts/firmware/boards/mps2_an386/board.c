/* The firmware on an Arm MPS2+ with a Cortex-M4 (AN386), emulated by QEMU: a serial link, a clock, and the
   simulated flotor on the chip, in lockstep. README.md explains how to build and run it, and what a real board needs
   instead.

   Interrupts only move bytes and wake the loop in main(), the only caller of the firmware. UART0 is the link to the
   host, UART1 the log. */
#include "device.h" /* written by build.py */
#include "simulated_flotor.h"

enum { MHZ = 25, RING = 1024, STACK = 16384, UNUSED = 0x5A5A5A5A };
enum { FULL = 1, CAME = 2 };                     /* bits of a UART's state */
enum { SENDS = 1, RECEIVES = 2, INTERRUPTS = 12 }; /* bits of its control */
enum { LEFT_INTERRUPT = 1, CAME_INTERRUPT = 2 };
#define AGAIN UINT64_C(20000000)    /* [ns]; a STATE is repeated after this time without an answer */
#define LET_GO UINT64_C(2000000000) /* [ns]; the host is dropped after this time */

struct uart { volatile uint32_t data, state, control, interrupts, divisor; };
struct timer { volatile uint32_t control, value, reload; };
struct waker { volatile uint32_t control, reload, value; };
#define LINE ((struct uart *)0x40004000)
#define LOG ((struct uart *)0x40005000)
#define CLOCK ((struct timer *)0x40000000)
#define WAKER ((struct waker *)0xE000E010) /* SysTick */
#define ENABLE_INTERRUPTS (*(volatile uint32_t *)0xE000E100)
#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88)

extern uint32_t data_start[], data_end[], bss_start[], bss_end[], stack_end[];
extern const uint32_t data_image[];

struct plant plant = {PLANT, .fault = NO_FAULT, .random = 1};
struct maglev_device device;
struct maglev_profile profile = {PROFILE};

struct ring { uint8_t bytes[RING]; volatile uint32_t head, tail; };
static struct ring came, leaving;
static struct { uint32_t sample, command, frame, wall, lost, again; } most; /* [clock counts], and numbers */

/* What the compiler needs of a C library, besides the firmware's memset. */
void *memcpy(void *to, const void *from, size_t count);
void *memcpy(void *to, const void *from, size_t count) {
    volatile uint8_t *place = to; /* volatile: else it may call itself */
    for (const uint8_t *next = from; count; count--) *place++ = *next++;
    return to;
}

/* ---- clock ---- */

static uint32_t counts(void) { return ~CLOCK->value; }

/* [ns]; called at least every 171 s. */
static uint64_t clock_now(void) {
    static uint64_t passed;
    passed += counts() - (uint32_t)passed;
    return passed * (1000 / MHZ);
}

/* ---- session numbers: no hardware generator, so a keyed hash of received frames and their times ---- */

static struct maglev_profile pool = {.key_length = MAGLEV_KEY}; /* initial key: the device's */
static uint32_t jitter; /* of all arrivals [clock counts] */

/* Tag of a frame with these numbers, with the pool as key. */
static void hash(uint64_t one, uint64_t other, uint8_t *tag) {
    struct maglev_frame frame = {MAGLEV_ESTOP, 0, 0, one, .of.estop.request = other};
    uint8_t data[MAGLEV_LARGEST];
    size_t end = maglev_encode(&pool, &frame, data) - 4; /* of the CRC */
    for (int i = 0; i < 16; i++) tag[i] = data[end - 16 + (size_t)i];
}

/* Mix in the nonce of a HELLO, drawn by the host. */
static void stir(const uint8_t *hello) {
    uint64_t nonce = 0;
    uint8_t first[16], second[16];
    for (int i = 0; i < 8; i++) nonce |= (uint64_t)hello[20 + i] << 8 * i;
    hash(nonce, (uint64_t)jitter << 1, first), hash(nonce, (uint64_t)jitter << 1 | 1, second);
    for (int i = 0; i < 16; i++) pool.key[i] = first[i], pool.key[16 + i] = second[i];
}

uint32_t draw(void *context) {
    static uint64_t drawn;
    uint8_t tag[16];
    (void)context;
    hash(0, UINT64_C(1) << 63 | ++drawn, tag); /* never hashed by stir() */
    return (uint32_t)tag[0] | (uint32_t)tag[1] << 8 | (uint32_t)tag[2] << 16 | (uint32_t)tag[3] << 24;
}

/* ---- line ---- */

static bool put(struct ring *ring, uint8_t byte) {
    uint32_t next = (ring->head + 1) % RING;
    if (next == ring->tail) return false;
    ring->bytes[ring->head] = byte, ring->head = next;
    return true;
}

static bool take(struct ring *ring, uint8_t *byte) {
    if (ring->tail == ring->head) return false;
    *byte = ring->bytes[ring->tail], ring->tail = (ring->tail + 1) % RING;
    return true;
}

static void byte_came(void) {
    LINE->interrupts = CAME_INTERRUPT;
    while (LINE->state & CAME) most.lost += !put(&came, (uint8_t)LINE->data);
}

static void byte_left(void) {
    LINE->interrupts = LEFT_INTERRUPT;
    uint8_t byte;
    while (!(LINE->state & FULL) && take(&leaving, &byte)) LINE->data = byte;
}

/* Drop a frame if the buffer is full: never wait for the host. */
static void send(const uint8_t *frame, size_t length) {
    uint8_t out[MAGLEV_STUFFED];
    size_t count = length ? maglev_stuff(frame, length, out) : 0;
    uint32_t room = (leaving.tail - leaving.head + RING - 1) % RING;
    for (size_t i = 0; count <= room && i < count; i++) put(&leaving, out[i]);
    __asm__ volatile("cpsid i");
    byte_left();
    __asm__ volatile("cpsie i");
}

/* Disable interrupts while a call is timed, to exclude their time. */
static uint32_t begin(void) {
    __asm__ volatile("cpsid i" ::: "memory");
    return counts();
}

static void note(uint32_t *longest, uint32_t before) {
    uint32_t took = counts() - before;
    __asm__ volatile("cpsie i" ::: "memory");
    if (took > *longest) *longest = took;
}

static void hear(void) {
    static struct maglev_line line;
    uint8_t byte, answer[MAGLEV_LARGEST];
    while (take(&came, &byte)) {
        size_t length = maglev_unstuff(&line, byte);
        if (!length) continue;
        jitter = (jitter ^ counts()) * 2654435761u;
        if (length > 28 && line.data[3] == MAGLEV_HELLO) stir(line.data);
        uint32_t before = begin();
        length = maglev_receive(&device, line.data, length, 0, answer);
        note(line.data[3] == MAGLEV_CMD ? &most.command : &most.frame, before);
        send(answer, length);
    }
}

/* ---- log: a line for each change of state, faults or current flow ---- */

static void print(const char *text) {
    for (; *text; text++) {
        while (LOG->state & FULL);
        LOG->data = (uint8_t)*text;
    }
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
    uint32_t *unused = stack_end - STACK / 4;
    while (*unused == UNUSED) unused++;
    say("us ", plant.now / 1000), say(" number ", plant.number), say(" state ", device.state);
    say(" faults ", device.faults), say(" flows ", flows);
    say(" sample ", most.sample), say(" command ", most.command), say(" frame ", most.frame);
    say(" wall ", most.wall), say(" lost ", most.lost), say(" again ", most.again);
    say(" stack ", (uint32_t)((stack_end - unused) * 4)), print("\n");
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
    else if (now - last >= AGAIN) last = now, most.again++, send(frame, length);
}

int main(void);
int main(void) {
    lay();
    for (uint32_t i = 0; i < profile.key_length; i++) pool.key[i] = profile.key[i];
    CLOCK->reload = CLOCK->value = UINT32_MAX, CLOCK->control = 1;
    WAKER->reload = MHZ * 1000 - 1, WAKER->value = 0, WAKER->control = 7; /* every millisecond */
    LOG->divisor = LINE->divisor = MHZ * 1000000 / BAUD;
    LOG->control = SENDS, LINE->control = SENDS | RECEIVES | INTERRUPTS;
    if (!maglev_start(&device, &profile, &hardware)) return 1;
    ENABLE_INTERRUPTS = 3;
    for (;;) {
        hear();
        run();
        tell();
        __asm__ volatile("cpsid i");
        if (came.tail == came.head) __asm__ volatile("wfi"); /* also wakes for pending interrupts */
        __asm__ volatile("cpsie i");
    }
}

/* ---- start ---- */

static void hang(void) { for (;;); }
static void wake(void) {}

void reset(void);
void reset(void) {
    COPROCESSORS |= 0xF << 20; /* the floating point unit */
    __asm__ volatile("dsb\n isb");
    for (uint32_t *to = data_start, i = 0; to + i < data_end; i++) to[i] = data_image[i];
    for (uint32_t *to = bss_start; to < bss_end; to++) *to = 0;
    for (uint32_t *to = stack_end - STACK / 4; to < (uint32_t *)__builtin_frame_address(0) - 16; to++) *to = UNUSED;
    main();
    hang();
}

struct vectors { uint32_t *stack; void (*handlers[17])(void); };
__attribute__((section(".vectors"), used)) static const struct vectors vectors = {
    stack_end, {reset, hang, hang, hang, hang, hang, 0, 0, 0, 0, hang, hang, 0, hang, wake, byte_came, byte_left}};
