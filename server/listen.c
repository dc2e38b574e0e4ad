/* The listening socket, bound before anything slow is started.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/listen.h"

#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

static enum err_code listen_failed(const struct server_config *cfg, struct err *e)
{
    int port = (int)cfg->port;
    if (errno == EADDRINUSE)
        return err_set(
            e, ERR_BUSY,
            "port %d of %s is in use by another program : choose one with --port N, or --port 0 "
            "for any free one",
            port, cfg->address);
    if (errno == EACCES)
        return err_set(e, ERR_IO,
                       "port %d : only root may listen below 1024 : choose another with --port N",
                       port);
    return err_errno(e, ERR_IO, "cannot listen on %s port %d", cfg->address, port);
}

enum err_code listen_open(const struct server_config *cfg, int *fd, uint16_t *port, struct err *e)
{
    char service[8];
    struct addrinfo hints = {.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV | AI_PASSIVE,
                             .ai_socktype = SOCK_STREAM};
    struct addrinfo *a = NULL;
    struct sockaddr_storage bound;
    socklen_t n = sizeof bound;
    const int yes = 1;
    *fd = -1;
    snprintf(service, sizeof service, "%d", (int)cfg->port);
    if (!cfg->address || getaddrinfo(cfg->address, service, &hints, &a) != 0)
        return err_set(e, ERR_ARG, "--address %s : not an IP address (127.0.0.1, 0.0.0.0, ::1, ::)",
                       cfg->address ? cfg->address : "\"\"");
    enum err_code rc = ERR_OK;
    *fd = socket(a->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (*fd < 0 || setsockopt(*fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0 ||
        bind(*fd, a->ai_addr, a->ai_addrlen) != 0 || listen(*fd, 1024) != 0 ||
        getsockname(*fd, (struct sockaddr *)&bound, &n) != 0)
        rc = listen_failed(cfg, e);
    else if (bound.ss_family == AF_INET6)
        *port = ntohs(((struct sockaddr_in6 *)(void *)&bound)->sin6_port);
    else
        *port = ntohs(((struct sockaddr_in *)(void *)&bound)->sin_port);
    freeaddrinfo(a);
    if (rc && *fd >= 0)
        close(*fd);
    return rc;
}
