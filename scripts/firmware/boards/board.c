/* What all boards share: start, frames on a serial link, session numbers, longest calls.

   Interrupts only move bytes, latch samples and switch currents; the loop in main() is the only caller of the
   firmware. */
#include "board.h"

extern uint32_t data_start[], data_end[], bss_start[], bss_end[], stack_end[];
extern const uint32_t data_image[];

#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88)

struct maglev_device device;
struct ring came, leaving;
struct most most;
uint64_t spent;

/* What the compiler needs of a C library, besides the firmware's memset. */
void *memcpy(void *to, const void *from, size_t count);
void *memcpy(void *to, const void *from, size_t count) {
    volatile uint8_t *place = to; /* volatile: else it may call itself */
    for (const uint8_t *next = from; count; count--) *place++ = *next++;
    return to;
}

/* ---- session numbers: a keyed hash of the chip's generator, if it has one, and of received frames and their times ---- */

static struct maglev_profile pool = {.key_length = MAGLEV_KEY}; /* initial key: the device's, see reset() */
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
    hash(chip_random(), UINT64_C(1) << 63 | ++drawn, tag); /* never hashed by stir() */
    return (uint32_t)tag[0] | (uint32_t)tag[1] << 8 | (uint32_t)tag[2] << 16 | (uint32_t)tag[3] << 24;
}

/* ---- line ---- */

bool put(struct ring *ring, uint8_t byte) {
    uint32_t next = (ring->head + 1) % RING;
    if (next == ring->tail) return false;
    ring->bytes[ring->head] = byte, ring->head = next;
    return true;
}

bool take(struct ring *ring, uint8_t *byte) {
    if (ring->tail == ring->head) return false;
    *byte = ring->bytes[ring->tail], ring->tail = (ring->tail + 1) % RING;
    return true;
}

/* Drop a frame if the buffer is full: never wait for the host. */
void send(const uint8_t *frame, size_t length) {
    uint8_t out[MAGLEV_STUFFED];
    size_t count = length ? maglev_stuff(frame, length, out) : 0;
    uint32_t room = (leaving.tail - leaving.head + RING - 1) % RING;
    for (size_t i = 0; count <= room && i < count; i++) put(&leaving, out[i]);
    __asm__ volatile("cpsid i");
    pump();
    __asm__ volatile("cpsie i");
}

/* Disable interrupts while a call is timed, to exclude their time. */
uint32_t begin(void) {
    __asm__ volatile("cpsid i" ::: "memory");
    return counts();
}

void note(uint32_t *longest, uint32_t before) {
    uint32_t took = counts() - before;
    __asm__ volatile("cpsie i" ::: "memory");
    if (took > *longest) *longest = took;
}

void hear(uint64_t period) {
    static struct maglev_line line;
    uint8_t byte, answer[MAGLEV_LARGEST];
    uint64_t last = clock_now();
    while ((profile.lockstep || spent < period / 2) && take(&came, &byte)) {
        size_t length = maglev_unstuff(&line, byte);
        if (!length) continue;
        jitter = (jitter ^ counts()) * 2654435761u;
        if (length > 28 && line.data[3] == MAGLEV_HELLO) stir(line.data);
        uint32_t before = begin();
        length = maglev_receive(&device, line.data, length, 0, answer);
        note(line.data[3] == MAGLEV_CMD ? &most.command : &most.frame, before);
        send(answer, length);
        uint64_t now = clock_now();
        spent += now - last, last = now;
    }
}

/* ---- start ---- */

uint32_t stack_used(void) {
    uint32_t *unused = stack_end - STACK / 4;
    while (*unused == UNUSED) unused++;
    return (uint32_t)((stack_end - unused) * 4);
}

void reset(void) {
    COPROCESSORS |= 0xF << 20; /* the floating point unit */
    __asm__ volatile("dsb\n isb");
    for (uint32_t *to = data_start, i = 0; to + i < data_end; i++) to[i] = data_image[i];
    for (uint32_t *to = bss_start; to < bss_end; to++) *to = 0;
    for (uint32_t *to = stack_end - STACK / 4; to < (uint32_t *)__builtin_frame_address(0) - 16; to++) *to = UNUSED;
    for (uint32_t i = 0; i < profile.key_length; i++) pool.key[i] = profile.key[i];
    main();
    for (;;); /* the enable line is still, so the amplifiers open */
}
