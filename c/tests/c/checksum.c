/* Prints a checksum of the attitudes of two seconds: the same on every processor. */
#include "aplomb.h"

void print(const char *text);

#if !defined(__arm__)
#include <stdio.h>

void print(const char *text)
{
    fputs(text, stdout);
}
#endif

static uint32_t checksum(uint32_t sum, const void *memory, unsigned size)
{
    const unsigned char *bytes = (const unsigned char *)memory;
    for (unsigned i = 0; i < size; i++) {
        sum = (sum ^ bytes[i]) * 16777619u;
    }
    return sum;
}

static void put(uint8_t *bytes, int value)
{
    bytes[0] = (uint8_t)((unsigned)value >> 8);
    bytes[1] = (uint8_t)value;
}

/* Rest for a second, then turns. */
static void make(uint32_t index, uint8_t bytes[14])
{
    int turn = index < 1000 ? 0 : (int)(index % 200) - 100;
    put(bytes, 3 * turn);
    put(bytes + 2, (int)(index % 7) - 3);
    put(bytes + 4, 2048 - turn / 4);
    put(bytes + 6, -3920);
    put(bytes + 8, 20 * turn + 5);
    put(bytes + 10, -7 * turn);
    put(bytes + 12, (int)(index % 5));
}

int main(void)
{
    static AplombPipeline pipeline;
    AplombSettings settings = aplomb_default_settings();
    AplombStatus status = aplomb_init(&pipeline, &settings);
    uint32_t sum = 2166136261u;
    char text[] = "checksum 00000000\n";
    for (uint32_t index = 1; index < 2000 && status == APLOMB_STATUS_OK; index++) {
        AplombBurst burst = {0, {0}, 0, 0, 0};
        AplombSnapshot snapshot;
        burst.captured_at_us = (uint64_t)index * 1000;
        make(index, burst.bytes);
        status = aplomb_update_burst(&pipeline, &burst, &snapshot);
        sum = checksum(sum, snapshot.attitude, sizeof snapshot.attitude);
        sum = checksum(sum, &snapshot.tilt_sigma_rad, sizeof snapshot.tilt_sigma_rad);
        sum = checksum(sum, &snapshot.flags, sizeof snapshot.flags);
    }
    for (int digit = 0; digit < 8; digit++) {
        text[9 + digit] = "0123456789abcdef"[(sum >> (28 - 4 * digit)) & 15];
    }
    print(status == APLOMB_STATUS_OK ? text : aplomb_status_text(status));
    return 0;
}
