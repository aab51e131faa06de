/* Laws of test_c_law.py: three with twins in Python, and one for each fault that a probe finds. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

void wall(double x, double v, const double *g, void *m, double *f) {
    (void)m;
    *f = -(g[0] * x + g[1] * v) * (x < 0.0);
}

struct low { double speed; };

void soft(double x, double v, const double *g, void *m, double *f) {
    struct low *s = m;
    s->speed = s->speed + g[2] * (v - s->speed);
    *f = -g[0] * x - g[1] * s->speed;
}

/* Fixed point: counts of 1 um, own difference in 1/256 count per sample, filter, force in 1/256 N. */
struct fix { int32_t last, speed, ready; };

void fixed(double x, double v, const double *g, void *m, double *f) {
    struct fix *s = m;
    int32_t count = (int32_t)floor(x * 1e6 + 0.5);
    (void)v;
    if (!s->ready) s->last = count, s->ready = 1;
    int32_t step = count - s->last;
    s->last = count;
    s->speed += ((int32_t)((uint32_t)step << 8) - s->speed) >> 2;
    int64_t force = -(int64_t)g[0] * count * 256 / 1000000 - (int64_t)g[1] * s->speed / 1000000;
    *f = (double)force / 256.0;
}

#define LAW(name) void name(double x, double v, const double *g, void *m, double *f)

LAW(crash) { (void)v, (void)g, (void)m; *f = 0.0; if (x > 0.05) *(volatile int *)0 = 1; }
LAW(stop) { (void)x, (void)v, (void)g, (void)m, (void)f; abort(); }
LAW(leave) { (void)x, (void)v, (void)g, (void)m, (void)f; exit(3); }
LAW(loop) { (void)x, (void)v, (void)g, (void)m; *f = 0.0; for (volatile int on = 1; on;) {} }
LAW(sleeps) { (void)x, (void)v, (void)g, (void)m; *f = 0.0; sleep(60); }
LAW(wild) { (void)x, (void)v, (void)g; ((double *)m)[1] = 1.0; *f = 0.0; }
LAW(below) { (void)x, (void)v, (void)g; ((char *)m)[-1] = 1; *f = 0.0; }
LAW(gains) { (void)x, (void)v, (void)m; ((double *)g)[0] = 1.0; *f = 0.0; }
LAW(beside) { (void)x, (void)v, (void)g, (void)m; f[0] = 0.0, f[1] = 2.0; }
LAW(more) { (void)v, (void)m; *f = -g[0] * x - g[1]; }
LAW(nothing) { (void)x, (void)v, (void)g, (void)m, (void)f; }
LAW(infinite) { (void)v, (void)g, (void)m; *f = 1.0 / x; }
LAW(counts) { static int n; (void)v, (void)g, (void)m; *f = -100.0 * x + 1e-3 * n++; }
/* restarted by the first sample of any device: no fault of one device alone */
LAW(shared) { static double last; int *on = m; (void)v; if (!*on) last = 0.0, *on = 1; *f = -g[0] * last; last = x; }
LAW(talks) { (void)v, (void)m; printf("x"); *f = -g[0] * x; }
/* beyond 100 m: nothing that a law must do well, as long as it returns */
LAW(ends) { (void)v, (void)m; *f = fabs(x) > 100.0 ? NAN : -g[0] * x; }
