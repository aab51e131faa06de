/* Frames that wait for the firmware, on a link that can deliver many at once, such as Ethernet. A flood of them must
   delay neither a sample nor an ESTOP: between two samples frames take at most half a period, and ESTOPs go first. */
#ifndef MAGLEV_QUEUE_H
#define MAGLEV_QUEUE_H

#include "maglev_firmware.h"

struct maglev_waiting { uint64_t peer; size_t length; uint8_t data[MAGLEV_LARGEST + 1]; };

/* Fill in the first six fields; the others start as zeros. `context` is the first argument of every call. */
struct maglev_queue {
    void *context;
    /* Store the oldest received frame and its peer, cut to MAGLEV_LARGEST + 1 bytes; return its length, 0 for none.
       Does not wait. */
    size_t (*next)(void *context, uint8_t *data, uint64_t *peer);
    void (*send)(void *context, uint64_t peer, const uint8_t *data, size_t length);
    uint64_t (*clock)(void *context); /* [ns]; normally `now` of the hardware */
    struct maglev_waiting *frames;    /* memory of `size` frames, 2 or more; one is for the next to arrive */
    uint32_t size;

    uint32_t first, count; /* waiting frames */
    uint32_t number;       /* sample after which `spent` was spent on frames [ns] */
    uint64_t spent;
};

/* Process received frames, ESTOPs first, until none waits or maglev_rests(). Call it whenever no sample is due, and once
   before each sample. In lockstep, where samples wait for frames, it returns after half a period of `clock`. */
void maglev_serve(struct maglev_device *device, struct maglev_queue *queue);

/* True if half a period has been spent on frames since the last sample: the others wait for the next. */
bool maglev_rests(const struct maglev_device *device, const struct maglev_queue *queue);

#endif
