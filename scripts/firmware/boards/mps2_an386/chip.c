/* Arm MPS2+ as AN386, a Cortex-M4 at 25 MHz, emulated by QEMU: UART0 is the link to the host, UART1 the log, timer 0
   the clock. */
#include "board.h"
#include "device.h"

enum { MHZ = 25 };
enum { FULL = 1, CAME = 2 };                       /* bits of a UART's state */
enum { SENDS = 1, RECEIVES = 2, INTERRUPTS = 12 }; /* bits of its control */
enum { LEFT_INTERRUPT = 1, CAME_INTERRUPT = 2 };

struct uart { volatile uint32_t data, state, control, interrupts, divisor; };
struct timer { volatile uint32_t control, value, reload; };
struct waker { volatile uint32_t control, reload, value; };
#define LINE ((struct uart *)0x40004000)
#define LOG ((struct uart *)0x40005000)
#define CLOCK ((struct timer *)0x40000000)
#define WAKER ((struct waker *)0xE000E010) /* SysTick */
#define ENABLE_INTERRUPTS (*(volatile uint32_t *)0xE000E100)

extern uint32_t stack_end[];

uint32_t counts(void) { return ~CLOCK->value; }

uint64_t clock_now(void) {
    static uint64_t passed;
    passed += counts() - (uint32_t)passed;
    return passed * (1000 / MHZ);
}

uint32_t chip_random(void) { return 0; }

static void byte_came(void) {
    LINE->interrupts = CAME_INTERRUPT;
    while (LINE->state & CAME) most.lost += !put(&came, (uint8_t)LINE->data);
}

void pump(void) {
    uint8_t byte;
    while (!(LINE->state & FULL) && take(&leaving, &byte)) LINE->data = byte;
}

static void byte_left(void) {
    LINE->interrupts = LEFT_INTERRUPT;
    pump();
}

void log_byte(uint8_t byte) {
    while (LOG->state & FULL);
    LOG->data = byte;
}

void start_line(void) {
    CLOCK->reload = CLOCK->value = UINT32_MAX, CLOCK->control = 1;
    WAKER->reload = MHZ * 1000 - 1, WAKER->value = 0, WAKER->control = 7; /* every millisecond */
    LOG->divisor = LINE->divisor = MHZ * 1000000 / BAUD;
    LOG->control = SENDS, LINE->control = SENDS | RECEIVES | INTERRUPTS;
    ENABLE_INTERRUPTS = 3;
}

static void hang(void) { for (;;); }
static void wake(void) {}

struct vectors { uint32_t *stack; void (*handlers[17])(void); };
__attribute__((section(".vectors"), used)) static const struct vectors vectors = {
    stack_end, {reset, hang, hang, hang, hang, hang, 0, 0, 0, 0, hang, hang, 0, hang, wake, byte_came, byte_left}};
