/* STM32F405, a Cortex-M4 at 168 MHz: USART1 on PA9 and PA10 is the link to the host, USART2 on PA2 the log of the
   emulated program, TIM2 the clock. QEMU's netduinoplus2 runs it too: see QEMU below. */
#include "board.h"
#include "chip.h"
#include "device.h"

/* QEMU has no clock control and no random number generator, and counts its timers at 1 GHz. */
#ifdef QEMU
enum { EMULATED = 1, MHZ = 1000 };
#else
enum { EMULATED = 0, MHZ = TIMER_MHZ };
#endif

enum { PATIENCE = 1000000 }; /* polls */
enum { HSE_ON = 1 << 16, HSE_READY = 1 << 17, PLL_ON = 1 << 24, PLL_READY = 1 << 25, HSE_FEEDS_PLL = 1 << 22 };
enum { PLL_DRIVES = 2, PLL_DRIVES_NOW = 2 << 2, APB1_QUARTER = 5 << 10, APB2_HALF = 4 << 13 };
enum { RNG_ON = 4, RNG_READY = 1, RNG_ERRORS = 6 };
enum { SLOW_FLASH_CACHED = 5 | 7 << 8 }; /* five wait states at 168 MHz */

extern uint32_t stack_end[];

uint32_t counts(void) { return TIM2->cnt; }

uint64_t clock_now(void) {
    static uint64_t passed;
    passed += counts() - (uint32_t)passed;
    return passed * 1000 / MHZ;
}

uint32_t chip_random(void) {
    for (int i = 0; i < PATIENCE && !EMULATED; i++)
        if (RNG->sr & RNG_ERRORS) return 0;
        else if (RNG->sr & RNG_READY) return RNG->dr;
    return 0;
}

static void serve(void) {
    while (USART1->sr & HAS) most.lost += !put(&came, (uint8_t)USART1->dr);
    pump();
}

void pump(void) {
    uint8_t byte;
    while (USART1->sr & TAKES && take(&leaving, &byte)) USART1->dr = byte;
    uint32_t wanted = leaving.tail == leaving.head ? 0 : ON_TAKES;
    if ((USART1->cr1 & ON_TAKES) != wanted) USART1->cr1 ^= ON_TAKES;
}

void log_byte(uint8_t byte) {
    while (!(USART2->sr & TAKES));
    USART2->dr = byte;
}

static void hang(void) { for (;;); }

static void until(reg *flags, uint32_t ready) {
    for (int i = 0; !(*flags & ready); i++)
        if (EMULATED) return;
        else if (i == PATIENCE) hang(); /* no crystal, or a wrong one: the amplifiers stay open */
}

/* 168 MHz from the crystal, 84 MHz on APB2 and its timers, 42 MHz on APB1 and 84 MHz for its timers. */
static void start_clocks(void) {
    FLASH_ACR = SLOW_FLASH_CACHED;
    RCC->cr |= HSE_ON, until(&RCC->cr, HSE_READY);
    RCC->pllcfgr = CRYSTAL_MHZ | 336 << 6 | HSE_FEEDS_PLL | 7 << 24; /* 336 MHz; halved; and 48 MHz for the generator */
    RCC->cr |= PLL_ON, until(&RCC->cr, PLL_READY);
    RCC->cfgr = APB1_QUARTER | APB2_HALF, RCC->cfgr |= PLL_DRIVES, until(&RCC->cfgr, PLL_DRIVES_NOW);
    RCC->ahb1enr |= 0x1F, RCC->ahb2enr |= 1 << 6;     /* ports A to E; the generator */
    RCC->apb1enr |= 0xF | 1 << 17, RCC->apb2enr |= 1 << 4; /* TIM2 to TIM5, USART2; USART1 */
    (void)RCC->apb2enr; /* the clocks need two cycles */
}

void start_line(void) {
    start_clocks();
    RNG->cr = RNG_ON;
    TIM2->arr = UINT32_MAX, TIM2->egr = UPDATES, TIM2->cr1 = RUNS;
    GPIOA->moder = (GPIOA->moder & ~(UINT32_C(3) << 4 | UINT32_C(15) << 18)) | 2 << 4 | 10 << 18; /* PA2, PA9, PA10 */
    GPIOA->afrl = (GPIOA->afrl & ~(UINT32_C(15) << 8)) | 7 << 8, GPIOA->afrh = (GPIOA->afrh & ~UINT32_C(0xFF0)) | 0x770;
    USART1->brr = (USART1_MHZ * 1000000 + BAUD / 2) / BAUD, USART2->brr = (USART2_MHZ * 1000000 + BAUD / 2) / BAUD;
    USART1->cr1 = ON | SENDS | RECEIVES | ON_HAS, USART2->cr1 = ON | SENDS;
    enable(USART1_IRQ, 2);
    SYSTICK->reload = CORE_MHZ * 1000 - 1, SYSTICK->value = 0, SYSTICK->control = 7; /* wakes every millisecond */
}

static void wake(void) {}

/* Entries of a program without these timers. */
__attribute__((weak)) void sample_timer(void) { hang(); }
__attribute__((weak)) void command_timer(void) { hang(); }
__attribute__((weak)) void wall_timer(void) { hang(); }

struct vectors { uint32_t *stack; void (*system[15])(void), (*handlers[IRQS])(void); };
__attribute__((section(".vectors"), used)) static const struct vectors vectors = {
    stack_end, {reset, hang, hang, hang, hang, hang, 0, 0, 0, 0, hang, hang, 0, hang, wake},
    {[TIM3_IRQ] = sample_timer, [TIM4_IRQ] = wall_timer, [USART1_IRQ] = serve, [TIM5_IRQ] = command_timer}};
