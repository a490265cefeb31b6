/* Attitude in a main loop: see cube_loop.c. */
#ifndef CUBE_LOOP_H
#define CUBE_LOOP_H

#include "aplomb.h"

bool attitude_start(void);
void attitude_edge(uint64_t now_us);
bool attitude_poll(AplombSnapshot *snapshot);

#endif
