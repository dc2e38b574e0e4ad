/* Communication with a supervisor, by libsystemd.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/supervisor.h"

#ifdef CITYSPLAT_SYSTEMD

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <systemd/sd-daemon.h>
#include <time.h>

/* A reload may end while the program stops. Nothing but STOPPING is true from then on, so the lock
 * is held while something is said. */
static pthread_mutex_t supervisor_lock = PTHREAD_MUTEX_INITIALIZER;
static bool supervisor_stops;

static void supervisor_say(const char *text, bool last)
{
    pthread_mutex_lock(&supervisor_lock);
    if (!supervisor_stops)
        sd_notify(0, text);
    supervisor_stops |= last;
    pthread_mutex_unlock(&supervisor_lock);
}

int supervisor_socket(const char *name)
{
    char **names = NULL;
    int n = sd_listen_fds_with_names(0, &names), found = -1;
    for (int i = 0; i < n && names; i++) {
        bool same = name ? !strcmp(names[i], name) : strcmp(names[i], "admin") != 0;
        if (found < 0 && same)
            found = SD_LISTEN_FDS_START + i;
        free(names[i]);
    }
    free(names);
    return found;
}

void supervisor_ready(const char *status)
{
    char text[1024];
    snprintf(text, sizeof text, "READY=1\nSTATUS=%s", status);
    supervisor_say(text, false);
}

void supervisor_reloading(void)
{
    char text[64];
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    snprintf(text, sizeof text, "RELOADING=1\nMONOTONIC_USEC=%lld",
             (long long)now.tv_sec * 1000000 + now.tv_nsec / 1000);
    supervisor_say(text, false);
}

void supervisor_stopping(void)
{
    supervisor_say("STOPPING=1", true);
}

double supervisor_watchdog_s(void)
{
    uint64_t us = 0;
    return sd_watchdog_enabled(0, &us) > 0 ? (double)us * 1e-6 : 0;
}

void supervisor_well(void)
{
    sd_notify(0, "WATCHDOG=1");
}

#else

int supervisor_socket(const char *name)
{
    (void)name;
    return -1;
}

void supervisor_ready(const char *status)
{
    (void)status;
}

void supervisor_reloading(void) {}

void supervisor_stopping(void) {}

double supervisor_watchdog_s(void)
{
    return 0;
}

void supervisor_well(void) {}

#endif
