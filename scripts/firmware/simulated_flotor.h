/* Simulated hardware for the firmware: a flotor for small angles, a hand, an amplifier board, sensors. The program owns
   plant, device and profile, supplies random numbers, advances simulated time and counts samples. */
#ifndef SIMULATED_FLOTOR_H
#define SIMULATED_FLOTOR_H

#include "maglev_firmware.h"

enum { COILS = MAGLEV_COILS, SWITCHES = 64, EXTRAS = 4 };
enum fault { DEAD_COIL, STUCK_AMPLIFIER, STUCK_DIODE, INVALID_DIODE, STUCK_DIODES, STUCK_COUNTER, NO_FAULT };

struct drive { uint64_t at, pulse_end; double held[COILS], pulsed[COILS]; };
struct extra { uint64_t at; double currents[COILS]; }; /* of walls */
struct plant {
    double wrench[36];            /* row-major, per current [N/A, N m/A] */
    double inertia[6];            /* mass three times, then moments of inertia [kg, kg m^2] */
    double gravity[6];            /* accelerations [m/s^2, rad/s^2] */
    double slopes[36];            /* row-major, spots per pose [1, m] */
    double rest[6];               /* pose on the lower stop [m, rad] */
    double noise;                 /* of spots, uniform, +/- [m] */
    double hand[6];               /* wrench [N, N m] between two times [ns] */
    uint64_t hand_from, hand_until;
    int fault, which;             /* of enum fault, starting at fault_at [ns]; index of the coil or diode */
    uint64_t fault_at;
    uint32_t number, random;      /* of the sample; state of the noise generator, not 0 */

    uint64_t rendered;            /* time of the next sample of walls [ns] */
    uint64_t now, live_until;     /* the rest starts as zeros, except pose and lying */
    double pose[6], twist[6], flowing[COILS], stuck[6], kept;
    struct drive on, due[SWITCHES];
    struct extra added, adding[EXTRAS];
    uint32_t conversions;
    int waiting, extras, lying, has_stuck;
};

extern struct plant plant;
extern struct maglev_device device;
extern struct maglev_profile profile;
extern const struct maglev_hardware hardware;

/* Put the flotor on its lower stop. */
void lay(void);

/* Advance the plant to a time [ns], exact between switches; no effect for a past time. */
void advance(uint64_t now);

/* Return the actual currents [A]. */
const double *flow(void);

/* Supplied by the program: 32 unpredictable bits; a call of maglev_wall(). */
uint32_t draw(void *context);
void render(void);

#endif
