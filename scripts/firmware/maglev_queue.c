/* See maglev_queue.h. A frame is read as soon as it is there, so that an ESTOP behind others is found by its type byte;
   only then is the oldest of the others processed. */
#include "maglev_queue.h"

static void process(struct maglev_device *d, struct maglev_queue *q, const struct maglev_waiting *frame) {
    uint8_t answer[MAGLEV_LARGEST];
    size_t length = maglev_receive(d, frame->data, frame->length, frame->peer, answer);
    if (length) q->send(q->context, frame->peer, answer, length);
}

bool maglev_rests(const struct maglev_device *d, const struct maglev_queue *q) {
    return !d->profile->lockstep && q->number == d->number && q->spent >= d->profile->period / 2;
}

void maglev_serve(struct maglev_device *d, struct maglev_queue *q) {
    uint64_t last = q->clock(q->context);
    if (d->profile->lockstep || q->number != d->number) q->number = d->number, q->spent = 0;
    while (q->spent < d->profile->period / 2) {
        struct maglev_waiting *arrived = q->frames + (q->first + q->count) % q->size;
        arrived->length = q->next(q->context, arrived->data, &arrived->peer);
        if (arrived->length > 3 && arrived->data[3] == MAGLEV_ESTOP) process(d, q, arrived);
        else if (arrived->length) q->count += q->count < q->size - 1; /* else there is no room: it is dropped */
        else if (q->count) {
            process(d, q, q->frames + q->first);
            q->first = (q->first + 1) % q->size, q->count--;
        } else return;
        uint64_t now = q->clock(q->context);
        q->spent += now - last, last = now;
    }
}
