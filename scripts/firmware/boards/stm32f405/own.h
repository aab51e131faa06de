/* The functions that a board with sensors and amplifiers brings: see README.md. */
#ifndef OWN_H
#define OWN_H

#include "maglev_firmware.h"

/* Set up pins, converters and amplifiers, with the amplifiers open and the enable line still. */
void own_start(void);

/* Fill in `spots` [m], `measured` [A], `conversions`, `valid` and `enabled`, all sampled now. Called at the sample, by
   an interrupt: 50 us at most. */
void own_read(struct maglev_reading *reading);

/* Set the six current loops [A]; at once, also from an interrupt: 10 us at most. */
void own_currents(const double *amperes);

/* Change the enable line, and nothing else may. */
void own_toggle(void);

#endif
