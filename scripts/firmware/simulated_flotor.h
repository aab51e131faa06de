/* Simulated hardware for the firmware: a flotor for small angles, a hand, an amplifier board, sensors. A program owns
   the plant, the device and its profile, and draws numbers; it moves simulated time on and counts the samples. */
#ifndef SIMULATED_FLOTOR_H
#define SIMULATED_FLOTOR_H

#include "maglev_firmware.h"

enum { COILS = MAGLEV_COILS, SWITCHES = 64 };
enum fault { DEAD_COIL, STUCK_AMPLIFIER, STUCK_DIODE, INVALID_DIODE, STUCK_DIODES, STUCK_COUNTER, NO_FAULT };

struct drive { uint64_t at, pulse_end; double held[COILS], pulsed[COILS]; };
struct plant {
    double wrench[36];            /* by rows, per current [N/A, N m/A] */
    double inertia[6];            /* the mass three times, then the moments [kg, kg m^2] */
    double gravity[6];            /* accelerations [m/s^2, rad/s^2] */
    double slopes[36];            /* by rows, of the spots per pose [1, m] */
    double rest[6];               /* pose on the lower stop [m, rad] */
    double noise;                 /* that a spot's reading jitters by [m] */
    double hand[6];               /* its wrench [N, N m] between two instants of the plant's time [ns] */
    uint64_t hand_from, hand_until;
    int fault, which;             /* of enum fault, from an instant on [ns]; number of the coil or diode */
    uint64_t fault_at;
    uint32_t number, random;      /* of the sample; state of the noise, not 0 */

    uint64_t now, live_until;     /* what follows begins as zeros, but for pose and lying */
    double pose[6], twist[6], flowing[COILS], stuck[6], kept;
    struct drive on, due[SWITCHES];
    uint32_t conversions;
    int waiting, lying, has_stuck;
};

extern struct plant plant;
extern struct maglev_device device;
extern struct maglev_profile profile;
extern const struct maglev_hardware hardware;

/* Lay the flotor on its lower stop. */
void lay(void);

/* Move the plant to an instant [ns], exactly between switches; do nothing if that is past. */
void advance(uint64_t now);

/* Return the flowing currents [A]. */
const double *flow(void);

/* Brought by the program: 32 bits that cannot be guessed. */
uint32_t draw(void *context);

#endif
