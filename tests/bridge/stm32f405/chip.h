/* The timers of the board as plain memory: test_firmware_board.py compiles device.c with this header in place of the
   chip's, and timers.c turns them. */
#ifndef CHIP_H
#define CHIP_H

#include <stdint.h>

struct timer { uint32_t cr1, dier, sr, egr, cnt, psc, arr; };
extern struct timer timers[3];
#define TIM3 (&timers[0])
#define TIM4 (&timers[1])
#define TIM5 (&timers[2])

enum { TIM3_IRQ, TIM4_IRQ, TIM5_IRQ };
enum { RUNS = 1, ONE_PULSE = 8, UPDATES = 1 };
enum { TIMER_MHZ = 84 };

static inline uint32_t masked(void) { return 0; }
static inline void restore(uint32_t before) { (void)before; }
void enable(int irq, uint8_t priority);
void sleep(void);
void sample_timer(void), command_timer(void), wall_timer(void);

#endif
