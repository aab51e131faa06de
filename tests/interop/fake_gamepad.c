/* A gamepad for GLFW where there is none: preloaded, it puts the folder $FAKE_INPUT in the place of /dev/input.
 *
 * FIFOs there are devices at rest, and what is written to them are their events: event3 is an Xbox 360 controller,
 * any other a joystick that nobody knows; the third axis of event1 rests at its end, as a throttle does.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <linux/input.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <unistd.h>

static const int keys[] = {BTN_A, BTN_B, BTN_X, BTN_Y, BTN_TL, BTN_TR, BTN_SELECT, BTN_START, BTN_MODE, BTN_THUMBL, BTN_THUMBR};
static const int axes[] = {ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ, ABS_HAT0X, ABS_HAT0Y};

static const char *redirected(const char *path, char *buffer) {
    const char *folder = getenv("FAKE_INPUT");
    if (folder == NULL || strncmp(path, "/dev/input", 10) != 0)
        return path;
    snprintf(buffer, 4096, "%s%s", folder, path + 10);
    return buffer;
}

int open(const char *path, int flags, ...) {
    static int (*next)(const char *, int, ...);
    char buffer[4096];
    va_list rest;
    va_start(rest, flags);
    int mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, int) : 0;
    va_end(rest);
    if (next == NULL)
        next = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open");
    const char *there = redirected(path, buffer);
    if (there != path) /* a FIFO without a writer would be at its end */
        flags = (flags & ~O_ACCMODE) | O_RDWR;
    return next(there, flags, mode);
}

DIR *opendir(const char *path) {
    static DIR *(*next)(const char *);
    char buffer[4096];
    if (next == NULL)
        next = (DIR * (*)(const char *)) dlsym(RTLD_NEXT, "opendir");
    return next(redirected(path, buffer));
}

int inotify_add_watch(int file, const char *path, uint32_t mask) {
    static int (*next)(int, const char *, uint32_t);
    char buffer[4096];
    if (next == NULL)
        next = (int (*)(int, const char *, uint32_t))dlsym(RTLD_NEXT, "inotify_add_watch");
    return next(file, redirected(path, buffer), mask);
}

static void set_bits(unsigned char *bits, const int *codes, size_t count) {
    for (size_t index = 0; index < count; index++)
        bits[codes[index] / 8] |= (unsigned char)(1 << codes[index] % 8);
}

static int number_of(int file) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path);
    return length > 0 ? path[length - 1] - '0' : -1;
}

static int answer(int device, unsigned long request, void *data) {
    int known = device == 3;
    unsigned number = _IOC_NR(request), size = _IOC_SIZE(request);
    memset(data, 0, size);
    if (request == EVIOCGID) {
        struct input_id id = {.bustype = BUS_USB, .vendor = 0x045e, .product = known ? 0x028e : 1, .version = 0x0114};
        memcpy(data, &id, sizeof id);
    } else if (number == _IOC_NR(EVIOCGNAME(0))) {
        return snprintf(data, size, "Test Stick");
    } else if (number == _IOC_NR(EVIOCGBIT(0, 0))) {
        int kinds[] = {EV_SYN, EV_KEY, EV_ABS};
        set_bits(data, kinds, 3);
    } else if (number == _IOC_NR(EVIOCGBIT(EV_KEY, 0))) {
        set_bits(data, keys, sizeof keys / sizeof *keys);
    } else if (number == _IOC_NR(EVIOCGBIT(EV_ABS, 0))) {
        set_bits(data, axes, sizeof axes / sizeof *axes);
    } else if (number >= _IOC_NR(EVIOCGABS(0)) && number < _IOC_NR(EVIOCGABS(ABS_CNT))) {
        unsigned axis = number - _IOC_NR(EVIOCGABS(0));
        struct input_absinfo stick = {.minimum = -32768, .maximum = 32767}, trigger = {.maximum = 255};
        stick.value = device == 1 && axis == ABS_Z ? 32767 : 0;
        struct input_absinfo hat = {.minimum = -1, .maximum = 1};
        memcpy(data, axis >= ABS_HAT0X ? &hat : known && (axis == ABS_Z || axis == ABS_RZ) ? &trigger : &stick, sizeof hat);
    }
    return 0;
}

int ioctl(int file, unsigned long request, ...) {
    static int (*next)(int, unsigned long, ...);
    struct stat status;
    va_list rest;
    va_start(rest, request);
    void *data = va_arg(rest, void *);
    va_end(rest);
    if (next == NULL)
        next = (int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl");
    if (_IOC_TYPE(request) == 'E' && fstat(file, &status) == 0 && S_ISFIFO(status.st_mode))
        return answer(number_of(file), request, data);
    return next(file, request, data);
}
