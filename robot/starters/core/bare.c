/* The parts that a microcontroller adds to core.c: a buffer for each connection, and the clocks. Only its size is used, see .ci/core. */
#include "core.h"

static char lines[CORE_LINKS][CORE_LINE + 2], answer[CORE_ANSWER + 1];
static volatile int64_t clock_register, timer_register;
static volatile double output_register;
static volatile size_t received, sent;

void core_drive(int device, double value) { output_register = device + value; }

int main(void)
{
    for (int link = 0;; link = (link + 1) % CORE_LINKS) {
        struct core_now now = {clock_register, timer_register};
        core_run(now);
        if (received)
            sent = core_line(link, lines[link], received, now, answer);
    }
}
