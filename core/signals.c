/* The stop flag that SIGINT, SIGTERM and SIGHUP set.
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
    if (sig == SIGHUP) /* a terminal that closes sends it twice: by the shell and by the kernel */
        return;
    /* The second one gets the default action: the user means it. */
    struct sigaction dfl = {.sa_handler = SIG_DFL};
    sigaction(sig, &dfl, NULL);
}

void signals_catch(void)
{
    struct sigaction sa = {.sa_handler = signals_on_signal}, hup;
    sigemptyset(&sa.sa_mask);
    sigaction(SIGINT, &sa, NULL);
    sigaction(SIGTERM, &sa, NULL);
    if (!sigaction(SIGHUP, NULL, &hup) && hup.sa_handler != SIG_IGN) /* ignored: by nohup */
        sigaction(SIGHUP, &sa, NULL);
}

bool signals_stopping(void)
{
    return signals_stop != 0;
}
