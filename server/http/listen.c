/* Listening sockets. They are bound before slow parts of the server start, or taken over from a
 * supervisor.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/listen.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { LISTEN_ADDRESS_MAX = 64 };

static enum err_code listen_failed(const char *address, int port, const char *option, struct err *e)
{
    if (errno == EADDRINUSE)
        return err_set(e, ERR_BUSY,
                       "port %d of %s is in use by another program, which `ss -ltnp sport = :%d` "
                       "names: stop that one, or choose another port with %s (0: any free one)",
                       port, address, port, option);
    if (errno == EACCES)
        return err_set(e, ERR_IO,
                       "port %d: only root may listen below 1024: choose another with %s", port,
                       option);
    if (errno == EADDRNOTAVAIL)
        return err_set(e, ERR_IO,
                       "cannot listen on %s: no interface of this machine has that address; "
                       "0.0.0.0 or :: is all of them",
                       address);
    return err_errno(e, ERR_IO, "cannot listen on %s port %d", address, port);
}

static uint16_t listen_port(const struct sockaddr_storage *bound)
{
    if (bound->ss_family == AF_INET6)
        return ntohs(((const struct sockaddr_in6 *)(const void *)bound)->sin6_port);
    return bound->ss_family == AF_INET
               ? ntohs(((const struct sockaddr_in *)(const void *)bound)->sin_port)
               : 0;
}

/* Free *out with freeaddrinfo. */
static enum err_code listen_find(const char *address, int port, const char *option,
                                 struct addrinfo **out, struct err *e)
{
    char service[8];
    const struct addrinfo hints = {.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV | AI_PASSIVE,
                                   .ai_socktype = SOCK_STREAM};
    snprintf(service, sizeof service, "%d", port);
    if (!address || getaddrinfo(address, service, &hints, out) != 0)
        return err_set(e, ERR_ARG, "%s %s: not an IP address (127.0.0.1, 0.0.0.0, ::1, ::)",
                       strcmp(option, LISTEN_PORT) ? option : "--address",
                       address ? address : "\"\"");
    return ERR_OK;
}

enum err_code listen_check(const char *address, struct err *e)
{
    struct addrinfo *a = NULL;
    enum err_code rc = listen_find(address, 0, LISTEN_PORT, &a, e);
    if (!rc)
        freeaddrinfo(a);
    return rc;
}

enum err_code listen_open(const char *address, int port, const char *option, int *fd,
                          uint16_t *taken, struct err *e)
{
    struct addrinfo *a = NULL;
    struct sockaddr_storage bound;
    socklen_t n = sizeof bound;
    const int yes = 1, no = 0;
    *fd = -1;
    enum err_code rc = listen_find(address, port, option, &a, e);
    if (rc)
        return rc;
    *fd = socket(a->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    /* :: takes IPv4, too, whatever net.ipv6.bindv6only says */
    if (*fd < 0 || setsockopt(*fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0 ||
        (a->ai_family == AF_INET6 &&
         setsockopt(*fd, IPPROTO_IPV6, IPV6_V6ONLY, &no, sizeof no) != 0) ||
        bind(*fd, a->ai_addr, a->ai_addrlen) != 0 || listen(*fd, 1024) != 0 ||
        getsockname(*fd, (struct sockaddr *)&bound, &n) != 0)
        rc = listen_failed(address, port, option, e);
    else
        *taken = listen_port(&bound);
    freeaddrinfo(a);
    if (rc && *fd >= 0)
        close(*fd);
    return rc;
}

/* "[::1]:8078" to an address [LISTEN_ADDRESS_MAX] and a port. */
static enum err_code listen_read_at(const char *text, const char *option, char *address, int *port,
                                    struct err *e)
{
    const char *colon = strrchr(text, ':'), *from = text;
    size_t n = colon ? (size_t)(colon - text) : 0;
    if (n >= 2 && text[0] == '[' && text[n - 1] == ']') {
        from++;
        n -= 2;
    }
    if (!n || n >= LISTEN_ADDRESS_MAX || !colon[1] || colon[1 + strspn(colon + 1, "0123456789")] ||
        strlen(colon + 1) > 5 || atoi(colon + 1) > 65535)
        return err_set(e, ERR_ARG,
                       "%s %.80s: an address and a port, as 127.0.0.1:8078 or [::1]:8078", option,
                       text);
    memcpy(address, from, n);
    address[n] = '\0';
    *port = atoi(colon + 1);
    return ERR_OK;
}

enum err_code listen_check_at(const char *text, const char *option, struct err *e)
{
    char address[LISTEN_ADDRESS_MAX];
    struct addrinfo *a = NULL;
    int port = 0;
    enum err_code rc = listen_read_at(text, option, address, &port, e);
    if (!rc)
        rc = listen_find(address, port, option, &a, e);
    if (!rc)
        freeaddrinfo(a);
    return rc;
}

/* An IPv4 address becomes ::ffff:a.b.c.d. */
static bool listen_as_in6(const char *address, struct sockaddr_in6 *out)
{
    struct addrinfo *a = NULL;
    const struct addrinfo hints = {.ai_flags = AI_NUMERICHOST | AI_V4MAPPED,
                                   .ai_family = AF_INET6,
                                   .ai_socktype = SOCK_STREAM};
    const bool ok = !getaddrinfo(address, NULL, &hints, &a);
    if (ok) {
        memcpy(out, a->ai_addr, sizeof *out);
        freeaddrinfo(a);
    }
    return ok;
}

/* Does `a` stand for all addresses of a kind to which `b` belongs? :: takes those of IPv4, too. */
static bool listen_is_all(const struct in6_addr *a, const struct in6_addr *b)
{
    static const struct in6_addr all_v4 = {.s6_addr = {[10] = 0xff, [11] = 0xff}};
    return IN6_IS_ADDR_UNSPECIFIED(a) ||
           (!memcmp(a, &all_v4, sizeof *a) && IN6_IS_ADDR_V4MAPPED(b));
}

bool listen_meet(const char *text, const char *address, int port)
{
    char host[LISTEN_ADDRESS_MAX];
    struct sockaddr_in6 a, b;
    int other = 0;
    if (listen_read_at(text, "", host, &other, NULL) || !port || other != port ||
        !listen_as_in6(host, &a) || !listen_as_in6(address, &b))
        return false;
    return listen_is_all(&a.sin6_addr, &b.sin6_addr) || listen_is_all(&b.sin6_addr, &a.sin6_addr) ||
           (!memcmp(&a.sin6_addr, &b.sin6_addr, sizeof a.sin6_addr) &&
            a.sin6_scope_id == b.sin6_scope_id);
}

enum err_code listen_open_at(const char *text, const char *option, int *fd, uint16_t *taken,
                             struct err *e)
{
    char address[LISTEN_ADDRESS_MAX];
    int port = 0;
    *fd = -1;
    enum err_code rc = listen_read_at(text, option, address, &port, e);
    return rc ? rc : listen_open(address, port, option, fd, taken, e);
}

enum err_code listen_take(int fd, uint16_t *port, struct err *e)
{
    int listens = 0;
    socklen_t n = sizeof listens;
    struct sockaddr_storage bound;
    socklen_t n_bound = sizeof bound;
    if (getsockopt(fd, SOL_SOCKET, SO_ACCEPTCONN, &listens, &n) != 0 || !listens ||
        getsockname(fd, (struct sockaddr *)&bound, &n_bound) != 0)
        return err_set(e, ERR_ARG,
                       "descriptor %d of the supervisor: not a stream socket that listens", fd);
    *port = listen_port(&bound);
    (void)fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
    (void)fcntl(fd, F_SETFD, FD_CLOEXEC);
    return ERR_OK;
}
