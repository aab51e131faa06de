/* A screen of few frames a second, for programs that are started with this library in LD_PRELOAD: on a virtual screen
   nothing holds a window back, which draws by software all the time. Whoever waits for a frame by sched_yield naps. */

#include <dlfcn.h>
#include <time.h>

static void nap(long milliseconds)
{
    struct timespec time = {0, milliseconds * 1000000};
    nanosleep(&time, 0);
}

int sched_yield(void)
{
    nap(1);
    return 0;
}

typedef int Put(void *, unsigned long, void *, void *, int, int, int, int, unsigned, unsigned, int);

int XShmPutImage(void *display, unsigned long drawable, void *context, void *image, int x, int y, int to_x, int to_y,
                 unsigned width, unsigned height, int event)
{
    static Put *real;
    if (!real)
        real = (Put *)dlsym(dlopen("libXext.so.6", RTLD_LAZY), "XShmPutImage");
    nap(200);
    return real(display, drawable, context, image, x, y, to_x, to_y, width, height, event);
}
