/* A conversation with itself: see self_test.h. A sound request must be answered 200. A malformed
 * one gets one answer at most, which refuses it, and then the end of the connection.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/self_test.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "server/documents/link.h"
#include "server/http.h"
#include "server/http/listen.h"

enum { SELF_TEST_REQUEST = 256, SELF_TEST_ANSWER = 16 << 10, SELF_TEST_WAIT_S = 5 };

static const struct self_test_case {
    const char *what, *bytes;
} self_test_cases[] = {
#define MALFORMED(what, bytes, status, strict) {what, bytes},
#include "server/malformed.def"
#undef MALFORMED
};
enum { SELF_TEST_CASES = sizeof self_test_cases / sizeof *self_test_cases };

static int self_test_dial(uint16_t port)
{
    const struct sockaddr_in at = {
        .sin_family = AF_INET, .sin_port = htons(port), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    const struct timeval wait = {.tv_sec = SELF_TEST_WAIT_S};
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (fd < 0)
        return -1;
    (void)setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &wait, sizeof wait);
    (void)setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &wait, sizeof wait);
    if (connect(fd, (const struct sockaddr *)&at, sizeof at) == 0)
        return fd;
    close(fd);
    return -1;
}

/* All that comes until the other end hangs up, which may be a reset where bytes were left unread.
 * 0, or an errno: EAGAIN, it does not hang up. The answer ends with NUL. */
static int self_test_hear(int fd, char answer[SELF_TEST_ANSWER])
{
    size_t n = 0;
    for (;;) {
        const ssize_t got = read(fd, answer + n, SELF_TEST_ANSWER - 1 - n);
        if (got < 0 && errno == EINTR)
            continue;
        n += got > 0 ? (size_t)got : 0;
        answer[n] = '\0';
        if (got == 0 || (got < 0 && errno == ECONNRESET))
            return 0;
        if (got < 0 || n == SELF_TEST_ANSWER - 1)
            return got < 0 ? errno : EMSGSIZE;
    }
}

/* The next status line: libmicrohttpd's own pages speak of "HTTP/1.1" as well. */
static const char *self_test_line(const char *text)
{
    static const char begin[] = "HTTP/1.";
    for (const char *p = strstr(text, begin); p; p = strstr(p + 1, begin))
        if (strlen(p) > sizeof begin + 3 && p[sizeof begin] == ' ' && p[sizeof begin + 1] >= '0' &&
            p[sizeof begin + 1] <= '9')
            return p + sizeof begin + 1;
    return NULL;
}

static enum err_code self_test_fail(const char *what, const char *how, int status, struct err *e)
{
    return err_set(e, ERR_INTERNAL,
                   "libmicrohttpd %s reads or answers requests in a way that this program was not "
                   "written for: %s was %s (%d) in a test of itself: nothing is served. Versions "
                   "0.9.75 to 1.0.1 work; the program must be linked with it as a shared library",
                   http_library(), what, how, status);
}

/* A connection broke: the machine's fault, or there is no memory; not that of the library. */
static enum err_code self_test_broken(struct err *e)
{
    return errno ? err_errno(e, ERR_IO, "a test of itself: the connection to its own listener")
                 : err_set(e, ERR_IO, "a test of itself: a request got no answer");
}

/* A command with routes of its own (`citysplat mark`) has none of this name. */
static enum err_code self_test_sound(const struct services *s, const char *line, const char *what,
                                     struct err *e)
{
    if (!line)
        return self_test_broken(e);
    return atoi(line) == (s->own ? 404 : 200)
               ? ERR_OK
               : self_test_fail(what, "not answered as it should", atoi(line), e);
}

static enum err_code self_test_malformed(const struct self_test_case *c, uint16_t port,
                                         bool patience, struct err *e)
{
    char bytes[SELF_TEST_REQUEST], answer[SELF_TEST_ANSWER] = "";
    const size_t n = strlen(c->bytes);
    const int fd = self_test_dial(port);
    if (fd < 0)
        return self_test_broken(e);
    for (size_t i = 0; i < n && i < sizeof bytes; i++)
        bytes[i] = c->bytes[i] == '~' ? '\0' : c->bytes[i];
    const bool asked = n <= sizeof bytes && send(fd, bytes, n, MSG_NOSIGNAL) == (ssize_t)n;
    const int broken = asked ? self_test_hear(fd, answer) : errno;
    close(fd);
    if (broken == EAGAIN && patience) /* a machine that is busy with something else */
        return self_test_malformed(c, port, false, e);
    if (broken == EAGAIN || broken == EMSGSIZE)
        return self_test_fail(c->what, "not followed by the end of the connection", 0, e);
    errno = broken;
    if (broken)
        return self_test_broken(e);
    const char *line = self_test_line(answer), *second = line ? self_test_line(line) : NULL;
    if (line && atoi(line) < 400)
        return self_test_fail(c->what, "not refused", atoi(line), e);
    return second ? self_test_fail(c->what, "answered twice", atoi(second), e) : ERR_OK;
}

static void self_test_request(char *out, size_t room)
{
    const struct link health = {.from = LINK_ROOT, .up = ""};
    char path[32];
    snprintf(out, room, "GET %s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
             link_text(link_healthz, &health, path, sizeof path));
}

static enum err_code self_test_plain(const struct services *s, uint16_t port, struct err *e)
{
    char ask[128], answer[SELF_TEST_ANSWER] = "";
    const int fd = self_test_dial(port);
    if (fd < 0)
        return self_test_broken(e);
    self_test_request(ask, sizeof ask);
    if (send(fd, ask, strlen(ask), MSG_NOSIGNAL) > 0)
        errno = self_test_hear(fd, answer);
    close(fd);
    enum err_code rc = self_test_sound(s, self_test_line(answer), "GET /healthz", e);
    for (size_t i = 0; !rc && i < SELF_TEST_CASES; i++)
        rc = self_test_malformed(&self_test_cases[i], port, true, e);
    return rc;
}

/* TLS is read by another function: one sound and one malformed request show that it is checked. */
static enum err_code self_test_tls(const struct services *s, uint16_t port, struct err *e)
{
    static const char malformed[] = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n: x\r\n\r\n";
    char ask[128], answer[SELF_TEST_ANSWER] = "";
    self_test_request(ask, sizeof ask);
    for (int i = 0; i < 2; i++) {
        const int fd = self_test_dial(port);
        if (fd < 0)
            return self_test_broken(e);
        memset(answer, 0, sizeof answer);
        const bool heard = tls_ask(fd, i ? malformed : ask, answer, sizeof answer - 1);
        close(fd);
        if (!i && !heard) { /* its client is GnuTLS's own, with the policy of this machine */
            log_warn("serve", "TLS is not tested: a client of this machine does not accept it");
            return ERR_OK;
        }
        const char *line = self_test_line(answer);
        if (!i && self_test_sound(s, line, "GET /healthz by TLS", e))
            return e->code;
        if (i && line && atoi(line) < 400)
            return self_test_fail("a malformed request by TLS", "not refused", atoi(line), e);
    }
    return ERR_OK;
}

/* Some machines let nobody connect to 127.0.0.1: a network of its own that is down, a sandbox. */
static bool self_test_can(void)
{
    static const int never[] = {ENETUNREACH, EHOSTUNREACH, ENETDOWN,     EADDRNOTAVAIL,
                                EPERM,       EACCES,       EAFNOSUPPORT, ETIMEDOUT};
    struct err e = {0};
    uint16_t port = 0;
    int listening = -1;
    errno = 0;
    enum err_code rc = listen_open("127.0.0.1", 0, LISTEN_PORT, &listening, &port, &e);
    const int fd = rc ? -1 : self_test_dial(port), code = errno;
    if (fd >= 0)
        close(fd);
    if (listening >= 0 && !rc)
        close(listening);
    for (size_t i = 0; fd < 0 && i < sizeof never / sizeof *never; i++)
        if (code == never[i]) {
            log_warn("serve", "does not test itself: nothing can connect to 127.0.0.1 here (%s)",
                     strerror(code));
            return false;
        }
    return true;
}

enum err_code self_test(struct services *s, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (!self_test_can())
        return ERR_OK;
    for (int tls = 0; !rc && tls <= (s->tls != NULL); tls++) {
        struct http *h = NULL;
        rc = http_open(s, tls ? HTTP_SELF_TLS : HTTP_SELF, &h, e);
        if (!rc)
            rc = http_start(h, e);
        if (!rc)
            rc = tls ? self_test_tls(s, http_port(h), e) : self_test_plain(s, http_port(h), e);
        http_close(&h);
    }
    return rc;
}
