/* Servers of objects for tests: nginx, from which stores are read, and a server that misbehaves on
 * request.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_RANGES_KIT_H
#define TESTS_RANGES_KIT_H

#include "tests/kit.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static inline int ranges_listen(uint16_t *port)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    socklen_t n = sizeof a;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_true(fd >= 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(listen(fd, 64), 0);
    assert_int_equal(getsockname(fd, (struct sockaddr *)&a, &n), 0);
    *port = ntohs(a.sin_port);
    return fd;
}

/* ---- nginx ---- */

struct ranges_nginx {
    pid_t pid;
    uint16_t port;
};

/* Serves the files of `dir`, which is also where it writes. False: there is no nginx. */
static inline bool ranges_nginx_start(struct ranges_nginx *g, const char *dir)
{
    struct err e = {0};
    struct buf b = {0};
    char conf[FILE_PATH_MAX];
    if (kit_run(&b, "command -v nginx") != 0) {
        print_message("skipped: no nginx (./bootstrap test installs it)\n");
        return false;
    }
    b.size = 0;
    close(ranges_listen(&g->port)); /* free a moment ago */
    buf_printf(&b,
               "%sdaemon off; worker_processes 1; pid %s/pid; error_log %s/error.log;\n"
               "events { worker_connections 256; }\nhttp { access_log off;\n",
               geteuid() ? "" : "user root; ", dir, dir);
    for (const char *const *of =
             (const char *const[]){"client_body", "proxy", "fastcgi", "uwsgi", "scgi", NULL};
         *of; of++)
        buf_printf(&b, "%s_temp_path %s/%s;\n", *of, dir, *of);
    buf_printf(&b, "server { listen 127.0.0.1:%u; root %s; } }\n", g->port, dir);
    kit_ok(file_join(conf, dir, "nginx.conf", &e), e);
    kit_ok(file_write(conf, b.data, b.size, &e), e);
    buf_free(&b);
    g->pid = fork();
    assert_true(g->pid >= 0);
    if (!g->pid) {
        prctl(PR_SET_PDEATHSIG, SIGTERM); /* a test that fails leaves none */
        execlp("nginx", "nginx", "-p", dir, "-c", conf, (char *)NULL);
        _exit(127);
    }
    for (double end_s = clock_s() + 20;;) { /* until it answers */
        struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(g->port)};
        a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        const bool there = connect(fd, (struct sockaddr *)&a, sizeof a) == 0;
        close(fd);
        if (there)
            return true;
        assert_true(clock_s() < end_s);
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
    }
}

static inline void ranges_nginx_stop(const struct ranges_nginx *g)
{
    kill(g->pid, SIGTERM);
    waitpid(g->pid, NULL, 0);
}

/* ---- one that misbehaves ---- */

enum ranges_way {
    RANGES_WELL,
    RANGES_BUSY,      /* every other answer is 503 */
    RANGES_DOWN,      /* all are 503 */
    RANGES_CUT,       /* every other body is cut short */
    RANGES_SILENT,    /* nothing is answered */
    RANGES_WHOLE,     /* Range is ignored */
    RANGES_UNNAMED,   /* neither ETag nor Last-Modified */
    RANGES_SHIFTED,   /* other bytes than asked for */
    RANGES_LONG,      /* more bytes than announced */
    RANGES_CODED,     /* Content-Encoding: gzip */
    RANGES_NONE,      /* 404 */
    RANGES_FORBIDDEN, /* 403 */
    RANGES_AROUND,    /* redirected to itself */
    RANGES_FILE       /* redirected to a file of the client */
};

static struct { /* of the whole test program */
    int fd;
    uint16_t port;
    pthread_t thread;
    pthread_mutex_t lock; /* for the next three */
    struct buf object;
    char etag[32];    /* "": there is no object */
    struct buf asked; /* the head of the last request */
    _Atomic int way;
    _Atomic unsigned n; /* requests */
    _Atomic bool over;
} ranges = {.lock = PTHREAD_MUTEX_INITIALIZER};

static inline void ranges_say(int fd, const void *bytes, size_t n)
{
    for (const uint8_t *p = bytes; n;) {
        const ssize_t k = send(fd, p, n, MSG_NOSIGNAL);
        if (k <= 0)
            return;
        p += k;
        n -= (size_t)k;
    }
}

static inline void ranges_part(int fd, int way, unsigned number, const char *head)
{
    struct buf b = {0};
    const char *range = strstr(head, "\nRange: bytes="), *same = strstr(head, "If-Match: "),
               *other = strstr(head, "If-None-Match: ");
    size_t first = 0, last = ranges.object.size - 1;
    char *end = NULL;
    if (range) {
        first = strtoull(range + 14, &end, 10);
        last = strtoull(end + 1, NULL, 10);
        last = last < ranges.object.size ? last : ranges.object.size - 1;
    }
    const bool whole = !range || way == RANGES_WHOLE;
    if (!ranges.etag[0])
        buf_printf(&b, "HTTP/1.1 404 None\r\nContent-Length: 0\r\n");
    else if (same && strncmp(same + 10, ranges.etag, strlen(ranges.etag)))
        buf_printf(&b, "HTTP/1.1 412 Precondition Failed\r\nContent-Length: 0\r\n");
    else if (other && !strncmp(other + 15, ranges.etag, strlen(ranges.etag)))
        buf_printf(&b, "HTTP/1.1 304 Not Modified\r\nETag: %s\r\n", ranges.etag);
    else if (whole)
        buf_printf(&b, "HTTP/1.1 200 OK\r\nContent-Length: %zu\r\n", ranges.object.size);
    else
        buf_printf(&b, "HTTP/1.1 206 Partial\r\nContent-Length: %zu\r\n", last - first + 1);
    const bool body = b.data[9] == '2';
    if (body && way != RANGES_UNNAMED)
        buf_printf(&b, "ETag: %s\r\n", ranges.etag);
    if (body && way == RANGES_CODED)
        buf_printf(&b, "Content-Encoding: gzip\r\n");
    if (body && !whole)
        buf_printf(&b, "Content-Range: bytes %zu-%zu/%zu\r\n", first + (way == RANGES_SHIFTED),
                   last + (way == RANGES_SHIFTED), ranges.object.size);
    buf_printf(&b, "Connection: close\r\n\r\n");
    ranges_say(fd, b.data, b.size);
    buf_free(&b);
    if (body) {
        size_t n = whole ? ranges.object.size : last - first + 1;
        n = way == RANGES_CUT && number % 2 ? n / 2 : n;
        ranges_say(fd, ranges.object.data + (whole ? 0 : first), n);
    }
}

static inline void ranges_answer(int fd)
{
    char head[8192];
    size_t n = 0;
    for (ssize_t k; n < sizeof head - 1; n += (size_t)k) {
        head[n] = '\0';
        if (strstr(head, "\r\n\r\n") || (k = recv(fd, head + n, sizeof head - 1 - n, 0)) <= 0)
            break;
    }
    head[n] = '\0';
    if (!strstr(head, "\r\n\r\n"))
        return;
    const int way = atomic_load(&ranges.way);
    const unsigned number = atomic_fetch_add(&ranges.n, 1);
    const char *say = NULL;
    pthread_mutex_lock(&ranges.lock);
    ranges.asked.size = 0;
    buf_add(&ranges.asked, head, n + 1);
    if (way == RANGES_DOWN || (way == RANGES_BUSY && number % 2))
        say = "503 Busy\r\nRetry-After: 0";
    else if (way == RANGES_NONE)
        say = "404 None";
    else if (way == RANGES_FORBIDDEN)
        say = "403 No";
    else if (way == RANGES_AROUND)
        say = "302 There\r\nLocation: /again";
    else if (way == RANGES_FILE)
        say = "302 There\r\nLocation: file:///etc/passwd";
    if (say) {
        char text[256];
        ranges_say(fd, text,
                   (size_t)snprintf(text, sizeof text,
                                    "HTTP/1.1 %s\r\nContent-Length: 0\r\nConnection: "
                                    "close\r\n\r\n",
                                    say));
    } else if (way == RANGES_SILENT) {
        struct pollfd p = {.fd = fd, .events = POLLIN};
        (void)poll(&p, 1, 3000); /* until the client leaves */
    } else {
        ranges_part(fd, way, number, head);
    }
    pthread_mutex_unlock(&ranges.lock);
}

static void *ranges_run(void *arg)
{
    (void)arg;
    while (!atomic_load(&ranges.over)) {
        struct pollfd p = {.fd = ranges.fd, .events = POLLIN};
        if (poll(&p, 1, 50) != 1)
            continue;
        const int fd = accept(ranges.fd, NULL, NULL);
        if (fd < 0)
            continue;
        ranges_answer(fd);
        close(fd);
    }
    return NULL;
}

/* Sets the object that it serves from now on, at every path. */
static inline void ranges_serve(const char *path, const char *etag)
{
    struct err e = {0};
    pthread_mutex_lock(&ranges.lock);
    buf_free(&ranges.object);
    kit_ok(file_read(path, 0, &ranges.object, &e), e);
    snprintf(ranges.etag, sizeof ranges.etag, "\"%s\"", etag);
    pthread_mutex_unlock(&ranges.lock);
}

static inline void ranges_start(void)
{
    ranges.fd = ranges_listen(&ranges.port);
    assert_int_equal(pthread_create(&ranges.thread, NULL, ranges_run, NULL), 0);
}

static inline void ranges_stop(void)
{
    atomic_store(&ranges.over, true);
    pthread_join(ranges.thread, NULL);
    close(ranges.fd);
    buf_free(&ranges.object);
    buf_free(&ranges.asked);
}

#endif
