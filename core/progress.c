/* Progress: on a terminal a bar with rate and time left, elsewhere a plain line every few seconds.
 * Only this file asks whether stderr is a terminal.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/base.h"

#define PROGRESS_TTY_S 0.1
#define PROGRESS_LINE_S 5.0
enum { PROGRESS_BAR = 24 };

static bool progress_off; /* -q; set before threads start */

void progress_quiet(bool quiet)
{
    progress_off = quiet;
}

static void progress_time(double s, char out[32])
{
    if (!(s >= 0.0) || s > 359999.0)
        snprintf(out, 32, "--:--");
    else if (s < 3600.0)
        snprintf(out, 32, "%d:%02d", (int)s / 60, (int)s % 60);
    else
        snprintf(out, 32, "%d:%02d:%02d", (int)s / 3600, (int)s / 60 % 60, (int)s % 60);
}

static void progress_print(const struct progress *p, const char *note, bool last)
{
    double spent = clock_s() - p->start_s;
    double share = p->total ? (double)p->done / (double)p->total : 0.0;
    double rate = spent > 0.0 ? (double)p->done / spent : 0.0;
    char left[32];
    progress_time(last ? spent : (rate > 0.0 ? (double)(p->total - p->done) / rate : -1.0), left);
    char line[400];
    if (p->tty) {
        char bar[PROGRESS_BAR + 1];
        int full = (int)(share * PROGRESS_BAR);
        for (int i = 0; i < PROGRESS_BAR; i++)
            bar[i] = i < full ? '#' : '.';
        bar[PROGRESS_BAR] = '\0';
        snprintf(line, sizeof line, "\r\033[K%s [%s] %3.0f%% %llu/%llu %.3g/s %s%s%s%s%s", p->what,
                 bar, 100.0 * share, (unsigned long long)p->done, (unsigned long long)p->total,
                 rate, left, last ? "" : " left", note ? "  " : "", note ? note : "",
                 last ? "\n" : "");
    } else {
        snprintf(line, sizeof line, "%s: %llu/%llu (%.0f%%) %.3g/s %s%s%s%s\n", p->what,
                 (unsigned long long)p->done, (unsigned long long)p->total, 100.0 * share, rate,
                 left, last ? "" : " left", note ? ", " : "", note ? note : "");
    }
    ssize_t put = write(STDERR_FILENO, line, strlen(line));
    (void)put; /* a progress bar that cannot be shown is no error */
}

void progress_start(struct progress *p, const char *what, uint64_t total)
{
    double now = clock_s();
    *p = (struct progress){.what = what,
                           .total = total,
                           .start_s = now,
                           .last_s = now,
                           .tty = isatty(STDERR_FILENO) != 0,
                           .active = !progress_off};
}

void progress_step(struct progress *p, uint64_t done, const char *note)
{
    p->done = done < p->total ? done : p->total;
    if (!p->active)
        return;
    double now = clock_s();
    if (now - p->last_s < (p->tty ? PROGRESS_TTY_S : PROGRESS_LINE_S))
        return;
    p->last_s = now;
    progress_print(p, note, false);
}

void progress_end(struct progress *p, const char *note)
{
    if (p->active)
        progress_print(p, note, true);
    p->active = false;
}
