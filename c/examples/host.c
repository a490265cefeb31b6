/* Attitudes from a table of bursts, on a computer.
 *
 *   cc host.c -I ../include ../../target/release/libaplomb_c.a -lpthread -ldl -lm -o host
 *   ./host < ../../target/fly/bursts.csv
 *
 * A line is t_us,bytes,flags: the bytes are 28 hexadecimal digits. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "aplomb.h"

/* Reads the fourteen bytes of a line. Returns false if there are fewer. */
static bool read_bytes(const char *digits, uint8_t bytes[14])
{
    for (int i = 0; i < 14; i++) {
        unsigned byte;
        if (sscanf(digits + 2 * i, "%2x", &byte) != 1) {
            return false;
        }
        bytes[i] = (uint8_t)byte;
    }
    return true;
}

int main(void)
{
    static AplombPipeline pipeline;
    AplombSettings settings = aplomb_default_settings();
    AplombStatus status = aplomb_init(&pipeline, &settings);
    char line[256];
    while (status == APLOMB_STATUS_OK && fgets(line, sizeof line, stdin) != NULL) {
        AplombBurst burst = {0};
        AplombSnapshot snapshot;
        char digits[29];
        if (sscanf(line, "%" SCNu64 ",%28[0-9a-f]", &burst.captured_at_us, digits) != 2 ||
            !read_bytes(digits, burst.bytes)) {
            continue; /* the header */
        }
        burst.missed_before = strstr(line, "MISSED") != NULL;
        aplomb_set_armed(&pipeline, strstr(line, "ARMED") != NULL);
        status = aplomb_update_burst(&pipeline, &burst, &snapshot);
        if (status != APLOMB_STATUS_OK) {
            break; /* no snapshot was written */
        }
        printf("%" PRIu64 " %.9g %.9g %.9g %.9g %" PRIu32 "\n", snapshot.t_us,
               (double)snapshot.attitude[0], (double)snapshot.attitude[1],
               (double)snapshot.attitude[2], (double)snapshot.attitude[3], snapshot.flags);
    }
    if (status != APLOMB_STATUS_OK) {
        fprintf(stderr, "%s\n", aplomb_status_text(status));
    }
    return status == APLOMB_STATUS_OK ? 0 : 1;
}
