/* Attitude in a main loop: see cube_loop.c. */
#ifndef CUBE_LOOP_H
#define CUBE_LOOP_H

#include "aplomb.h"

bool attitude_start(uint32_t count_us);
void attitude_edge(uint32_t count_us);
bool attitude_poll(uint32_t count_us, AplombSnapshot *snapshot);

#endif
