/* Registers of the STM32F405, F407, F415 and F417 (ST RM0090): those that chip.c and device.c use. */
#ifndef CHIP_H
#define CHIP_H

#include <stdint.h>

typedef volatile uint32_t reg;
struct timer { reg cr1, cr2, smcr, dier, sr, egr, ccmr1, ccmr2, ccer, cnt, psc, arr; };
struct usart { reg sr, dr, brr, cr1, cr2, cr3; };
struct port { reg moder, otyper, ospeedr, pupdr, idr, odr, bsrr, lckr, afrl, afrh; };
struct clocks { reg cr, pllcfgr, cfgr, cir, ahb1rstr, ahb2rstr, ahb3rstr, gap, apb1rstr, apb2rstr, gaps[2], ahb1enr,
                ahb2enr, ahb3enr, gap2, apb1enr, apb2enr; };
struct generator { reg cr, sr, dr; };
struct waker { reg control, reload, value; };

#define TIM2 ((struct timer *)0x40000000) /* 32 bits: the clock */
#define TIM3 ((struct timer *)0x40000400) /* samples */
#define TIM4 ((struct timer *)0x40000800) /* currents of walls */
#define TIM5 ((struct timer *)0x40000C00) /* 32 bits: commanded currents */
#define USART1 ((struct usart *)0x40011000)
#define USART2 ((struct usart *)0x40004400)
#define GPIOA ((struct port *)0x40020000)
#define RCC ((struct clocks *)0x40023800)
#define FLASH_ACR (*(reg *)0x40023C00)
#define RNG ((struct generator *)0x50060800)
#define SYSTICK ((struct waker *)0xE000E010)
#define NVIC_ENABLE ((reg *)0xE000E100)
#define NVIC_PRIORITY ((volatile uint8_t *)0xE000E400) /* lower numbers first */

enum { TIM3_IRQ = 29, TIM4_IRQ = 30, USART1_IRQ = 37, TIM5_IRQ = 50, IRQS = 51 };
enum { RUNS = 1, ONE_PULSE = 8, UPDATES = 1 };                      /* timer: cr1; dier, sr and egr */
enum { TAKES = 1 << 7, HAS = 1 << 5 };                              /* usart: sr */
enum { ON = 1 << 13, SENDS = 1 << 3, RECEIVES = 1 << 2, ON_TAKES = 1 << 7, ON_HAS = 1 << 5 }; /* usart: cr1 */

enum { CORE_MHZ = 168, TIMER_MHZ = 84, USART1_MHZ = 84, USART2_MHZ = 42 };

static inline void enable(int irq, uint8_t priority) {
    NVIC_PRIORITY[irq] = (uint8_t)(priority << 4), NVIC_ENABLE[irq / 32] = UINT32_C(1) << irq % 32;
}

/* Hold interrupts back, and let them come as before. */
static inline uint32_t masked(void) {
    uint32_t before;
    __asm__ volatile("mrs %0, primask\n cpsid i" : "=r"(before)::"memory");
    return before;
}
static inline void restore(uint32_t before) { __asm__ volatile("msr primask, %0" ::"r"(before) : "memory"); }
static inline void sleep(void) { __asm__ volatile("wfi"); }

void sample_timer(void), command_timer(void), wall_timer(void); /* interrupts of device.c */

#endif
