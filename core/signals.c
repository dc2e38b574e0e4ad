/* The stop flag that SIGINT and SIGTERM set.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <signal.h>
#include <stddef.h>

#include "core/base.h"

static volatile sig_atomic_t signals_stop; /* set by the signal handler alone */

static void signals_on_signal(int sig)
{
    signals_stop = 1;
    /* The second one gets the default action: the user means it. */
    struct sigaction dfl = {.sa_handler = SIG_DFL};
    sigaction(sig, &dfl, NULL);
}

void signals_catch(void)
{
    struct sigaction sa = {.sa_handler = signals_on_signal};
    sigemptyset(&sa.sa_mask);
    sigaction(SIGINT, &sa, NULL);
    sigaction(SIGTERM, &sa, NULL);
}

bool signals_stopping(void)
{
    return signals_stop != 0;
}
