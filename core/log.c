/* The log on stderr, as text or JSON: one line an event. A line is composed first and written by
 * one call, so that lines of several threads do not mix.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "core/base.h"
#include "core/pool.h"

static enum log_level log_level = LOG_INFO; /* set before threads start */

void log_set_level(enum log_level level)
{
    log_level = level;
}

enum log_level log_get_level(void)
{
    return log_level;
}

static bool log_json;

void log_set_json(bool json)
{
    log_json = json;
}

bool log_is_json(void)
{
    return log_json;
}

/* Is stderr the journal of systemd? It says which file that is (systemd.exec(5)). */
static bool log_journal;
static pthread_once_t log_journal_once = PTHREAD_ONCE_INIT;

static void log_find_journal(void)
{
    unsigned long long device, inode;
    struct stat st;
    const char *text = getenv("JOURNAL_STREAM");
    log_journal = text && sscanf(text, "%llu:%llu", &device, &inode) == 2 &&
                  !fstat(STDERR_FILENO, &st) && st.st_dev == device && st.st_ino == inode;
}

const char *log_priority(enum log_level level)
{
    static const char *const priorities[] = {"<3>", "<4>", "<6>", "<7>"};
    pthread_once(&log_journal_once, log_find_journal);
    return log_journal ? priorities[level] : "";
}

void log_now(char out[32])
{
    struct timespec now;
    struct tm utc;
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &utc);
    size_t n = strftime(out, 32, "%Y-%m-%dT%H:%M:%S", &utc);
    snprintf(out + n, 32 - n, ".%03dZ", (int)(now.tv_nsec / 1000000));
}

/* Bytes of the UTF-8 letter that begins at p (RFC 3629); 0: there is none. */
static size_t log_letter(const unsigned char *p)
{
    if (*p < 0x80)
        return 1;
    const size_t n = *p >= 0xc2 && *p < 0xe0 ? 2 : *p >= 0xe0 && *p < 0xf0 ? 3 : *p >= 0xf0 ? 4 : 0;
    if (!n || *p > 0xf4)
        return 0;
    for (size_t i = 1; i < n; i++)
        if ((p[i] & 0xc0) != 0x80)
            return 0;
    const bool too_long = (*p == 0xe0 && p[1] < 0xa0) || (*p == 0xf0 && p[1] < 0x90);
    const bool surrogate = *p == 0xed && p[1] >= 0xa0, beyond = *p == 0xf4 && p[1] >= 0x90;
    return too_long || surrogate || beyond ? 0 : n;
}

size_t log_quote(const char *text, char *out, size_t room)
{
    static const char unknown[] = "\\ufffd";
    size_t n = 0, letter;
    for (const char *p = text; *p && n + 7 < room; p += letter ? letter : 1) {
        unsigned char c = (unsigned char)*p;
        letter = log_letter((const unsigned char *)p);
        if (c == '"' || c == '\\') {
            out[n++] = '\\';
            out[n++] = *p;
        } else if (c < 0x20 || c == 0x7f) {
            n += (size_t)snprintf(out + n, room - n, "\\u%04x", c);
        } else {
            const size_t m = letter ? letter : sizeof unknown - 1;
            memcpy(out + n, letter ? p : unknown, m);
            n += m;
        }
    }
    out[n] = '\0';
    return n;
}

static const char *const log_names[] = {"error", "warn", "info", "debug"};

static size_t log_vcompose_json(char *line, size_t room, enum log_level level, const char *module,
                                const char *fmt, va_list ap) ERR_PRINTF(5, 0);
static size_t log_vcompose_json(char *line, size_t room, enum log_level level, const char *module,
                                const char *fmt, va_list ap)
{
    char text[1024], quoted[1400], now[32];
    log_now(now);
    vsnprintf(text, sizeof text, fmt, ap);
    log_quote(text, quoted, sizeof quoted);
    int n = snprintf(line, room,
                     "%s{\"ts\":\"%s\",\"level\":\"%s\",\"module\":\"%s\",\"msg\":\"%s\"}\n",
                     log_priority(level), now, log_names[level], module, quoted);
    return n > 0 && (size_t)n < room ? (size_t)n : 0;
}

static size_t log_vcompose(char *line, size_t room, enum log_level level, const char *module,
                           const char *fmt, va_list ap) ERR_PRINTF(5, 0);
static size_t log_vcompose(char *line, size_t room, enum log_level level, const char *module,
                           const char *fmt, va_list ap)
{
    if (level > log_level)
        return 0;
    if (log_json)
        return log_vcompose_json(line, room, level, module, fmt, ap);
    int n = snprintf(line, room, "%s%.2f %s %s ", log_priority(level), clock_s(), log_names[level],
                     module);
    if (n < 0 || (size_t)n + 1 >= room)
        return 0;
    int m = vsnprintf(line + n, room - (size_t)n - 1, fmt, ap);
    size_t len = m < 0 ? (size_t)n : strlen(line);
    line[len++] = '\n';
    return len;
}

size_t log_compose(char *line, size_t room, enum log_level level, const char *module,
                   const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    size_t len = log_vcompose(line, room, level, module, fmt, ap);
    va_end(ap);
    return len;
}

static void log_put(const char *lines, size_t n)
{
    for (size_t at = 0; at < n;) {
        ssize_t put = write(STDERR_FILENO, lines + at, n - at);
        if (put <= 0)
            return; /* stderr is gone: nothing sensible is left to do */
        at += (size_t)put;
    }
}

/* ---- the queue ---- */

/* Two halves: callers fill one while the thread writes the other. A reader of stderr that stops
 * holds up the thread alone. */
enum { LOG_QUEUE_BYTES = 1 << 20 };
static struct {
    pthread_mutex_t lock;
    pthread_cond_t filled, written;
    char *fill, *spare;
    size_t n, dropped; /* bytes that wait, lines that found no room */
    bool on, stop, busy;
    struct pool_thread *thread;
} log_queue = {.lock = PTHREAD_MUTEX_INITIALIZER,
               .filled = PTHREAD_COND_INITIALIZER}; /* .written: by log_start */

static void log_main(void *user)
{
    char note[128];
    (void)user;
    pthread_mutex_lock(&log_queue.lock);
    for (;;) {
        while (!log_queue.n && !log_queue.dropped && !log_queue.stop)
            pthread_cond_wait(&log_queue.filled, &log_queue.lock);
        if (!log_queue.n && !log_queue.dropped)
            break;
        char *full = log_queue.fill;
        size_t n = log_queue.n, dropped = log_queue.dropped;
        log_queue.fill = log_queue.spare;
        log_queue.spare = full;
        log_queue.n = log_queue.dropped = 0;
        log_queue.busy = true;
        pthread_mutex_unlock(&log_queue.lock);
        log_put(full, n);
        if (dropped)
            log_put(note, log_compose(note, sizeof note, LOG_WARN, "log",
                                      "lines dropped, stderr is read too slowly: %zu", dropped));
        pthread_mutex_lock(&log_queue.lock);
        log_queue.busy = false;
        pthread_cond_broadcast(&log_queue.written);
    }
    pthread_mutex_unlock(&log_queue.lock);
}

enum err_code log_start(struct err *e)
{
    enum err_code rc = ERR_OK;
    pthread_mutex_lock(&log_queue.lock);
    if (log_queue.on) {
        pthread_mutex_unlock(&log_queue.lock);
        return ERR_OK;
    }
    log_queue.fill = mem_array(LOG_QUEUE_BYTES, 1);
    log_queue.spare = mem_array(LOG_QUEUE_BYTES, 1);
    if (!log_queue.fill || !log_queue.spare)
        rc = err_set(e, ERR_MEM, "log: out of memory");
    log_queue.stop = false;
    pool_cond_init(&log_queue.written);
    if (!rc)
        rc = pool_start(log_main, NULL, &log_queue.thread, e);
    log_queue.on = !rc;
    if (rc) {
        mem_free(log_queue.fill);
        mem_free(log_queue.spare);
        log_queue.fill = log_queue.spare = NULL;
    }
    pthread_mutex_unlock(&log_queue.lock);
    return rc;
}

void log_stop(double wait_s)
{
    const double end_s = clock_s() + wait_s + 1;
    pthread_mutex_lock(&log_queue.lock);
    bool late = !log_queue.on;
    while ((log_queue.n || log_queue.dropped || log_queue.busy) && !late)
        late = !pool_cond_wait(&log_queue.written, &log_queue.lock, end_s);
    log_queue.stop = !late;
    pthread_cond_signal(&log_queue.filled);
    pthread_mutex_unlock(&log_queue.lock);
    if (late)
        return; /* it hangs in write(): lines go on into the queue, and nobody waits for them */
    pool_join(&log_queue.thread);
    pthread_mutex_lock(&log_queue.lock);
    log_queue.on = false;
    log_queue.n = 0; /* of a thread that still writes lines */
    mem_free(log_queue.fill);
    mem_free(log_queue.spare);
    log_queue.fill = log_queue.spare = NULL;
    pthread_mutex_unlock(&log_queue.lock);
}

void log_write(const char *lines, size_t n)
{
    pthread_mutex_lock(&log_queue.lock);
    if (!log_queue.on) {
        pthread_mutex_unlock(&log_queue.lock);
        log_put(lines, n);
        return;
    }
    if (log_queue.n + n <= LOG_QUEUE_BYTES) {
        memcpy(log_queue.fill + log_queue.n, lines, n);
        log_queue.n += n;
    } else {
        for (size_t i = 0; i < n; i++)
            log_queue.dropped += lines[i] == '\n';
    }
    pthread_cond_signal(&log_queue.filled);
    pthread_mutex_unlock(&log_queue.lock);
}

void log_line(enum log_level level, const char *module, const char *fmt, ...)
{
    char line[1600];
    va_list ap;
    va_start(ap, fmt);
    size_t len = log_vcompose(line, log_json ? sizeof line : 1024, level, module, fmt, ap);
    va_end(ap);
    log_write(line, len);
}
