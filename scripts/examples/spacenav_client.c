/* A client of spacenav in C99, with libspnav: prints the events of a 3D mouse, and compares them with what they should be.

       cc -std=c99 -O2 scripts/examples/spacenav_client.c -o spacenav_client -lspnav -lm
       spacenav_client COUNT [FILE [SENSITIVITY]]    ends after so many motions; FILE has a line of six numbers for each
       spacenav_client stall                         connects and never reads, until its standard input ends

   At the end it says where an object would be that libspnav's own spnav_posrot_moveobj has moved, and how turned (x, y,
   z, w): a thousandth of a unit, or of a radian, for each number of each event. Buttons are printed and not counted.
   Where the server is says SPNAV_SOCKET. Exit status: 0, 1 if an event is not there or not right, 2 for bad input. */
#include <spnav.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static void fail(const char *what, const char *name) {
    fprintf(stderr, "spacenav_client: %s: %s\n", what, name);
    exit(2);
}

/* What spnav_sensitivity does in libspnav 1.2; that of 1.0 and 1.1 sends no number that it is given. */
static int set_sensitivity(float value) {
    int32_t packet[8] = {0x7faa1001};
    memcpy(packet + 1, &value, sizeof value);
    if (write(spnav_fd(), packet, sizeof packet) != sizeof packet) return -1;
    if (read(spnav_fd(), packet, sizeof packet) != sizeof packet) return -1;
    return packet[7];
}

static void describe(void) {
    char name[64] = "";
    int length = spnav_dev_name(name, sizeof name);
    spnav_client_name("spacenav_client, a program of rather a long name");
    printf("protocol %d, device '%s' (%d), %d axes, %d buttons, type %d\n", spnav_protocol(), name, length,
           spnav_dev_axes(), spnav_dev_buttons(), spnav_dev_type());
    fflush(stdout);
}

static int as_expected(const spnav_event *event, FILE *rows) {
    int place, number;
    for (place = 0; place < 6; place++)
        if (fscanf(rows, "%d", &number) != 1 || number != event->motion.data[place]) return 0;
    return 1;
}

int main(int count, char **arguments) {
    spnav_event event;
    struct spnav_posrot object; /* x right, y up, z towards the person; right-handed */
    FILE *rows = NULL;
    long wanted, got = 0, right = 0;
    char *end = "";

    if (count < 2 || count > 4) fail("usage", "spacenav_client COUNT [FILE [SENSITIVITY]] | stall");
    wanted = strcmp(arguments[1], "stall") ? strtol(arguments[1], &end, 10) : 0;
    if (*end || wanted < 0) fail("COUNT must be a number", arguments[1]);
    if (count >= 3 && !(rows = fopen(arguments[2], "r"))) fail("cannot read", arguments[2]);
    if (spnav_open() == -1) fail("nobody answers at SPNAV_SOCKET or /var/run/spnav.sock", "spnav_open");
    if (count == 4 && set_sensitivity(atof(arguments[3])) == -1) fail("refused", arguments[3]);
    describe();
    spnav_posrot_init(&object);
    if (!strcmp(arguments[1], "stall")) {
        while (getchar() != EOF) continue;
        return 0;
    }
    while (got < wanted && spnav_wait_event(&event)) {
        if (event.type == SPNAV_EVENT_BUTTON) {
            printf("button %d %s\n", event.button.bnum, event.button.press ? "pressed" : "released");
            fflush(stdout);
        }
        if (event.type != SPNAV_EVENT_MOTION) continue;
        got++;
        spnav_posrot_moveobj(&object, &event.motion);
        right += !rows || as_expected(&event, rows);
        printf("%d %d %d %d %d %d %u\n", event.motion.x, event.motion.y, event.motion.z, event.motion.rx,
               event.motion.ry, event.motion.rz, event.motion.period);
        fflush(stdout);
    }
    printf("moved %.3f %.3f %.3f, turned %.3f %.3f %.3f %.3f\n", object.pos[0], object.pos[1], object.pos[2],
           object.rot[0], object.rot[1], object.rot[2], object.rot[3]);
    printf("%ld of %ld events%s\n", right, wanted, rows ? " as expected" : "");
    spnav_close();
    return right == wanted ? 0 : 1;
}
