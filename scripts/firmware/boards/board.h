/* A board with the firmware on a serial link: what all chips share, and what each chip and program supplies. */
#ifndef BOARD_H
#define BOARD_H

#include "maglev_firmware.h"

enum { RING = 1024, STACK = 16384, UNUSED = 0x5A5A5A5A };

struct ring { uint8_t bytes[RING]; volatile uint32_t head, tail; };
struct most { uint32_t sample, command, frame, wall, lost, again; }; /* [clock counts], and numbers */

extern struct maglev_device device;
extern struct maglev_profile profile;
extern struct ring came, leaving;
extern struct most most; /* longest calls since the start, for a log or a debugger */

/* board.c */
bool put(struct ring *ring, uint8_t byte);   /* false if it is full */
bool take(struct ring *ring, uint8_t *byte); /* false if it is empty */
void send(const uint8_t *frame, size_t length);
extern uint64_t spent;       /* on frames since the last sample [ns]; the program sets it to 0 at each */
void hear(uint64_t period);  /* process received bytes, and send the answers; in real time for at most half a period */
uint32_t begin(void); /* of a timed call, without interrupts */
void note(uint32_t *longest, uint32_t before);
uint32_t draw(void *context); /* 32 bits for a session number */
uint32_t stack_used(void); /* [bytes] */

/* chip.c: clocks, UARTs, vectors */
uint32_t counts(void); /* free-running clock */
uint64_t clock_now(void); /* [ns]; never decreases; called at least once while counts() wraps */
uint32_t chip_random(void); /* of a hardware generator; 0 without one */
void start_line(void);
void pump(void); /* move bytes of `leaving` to the link as far as it takes them; called without interrupts */
void log_byte(uint8_t byte);
void reset(void);

/* program: main() is called by reset() */
int main(void);

#endif
