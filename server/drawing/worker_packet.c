/* Messages between the two processes: packets of a Unix socket, one for a request and one for an
 * answer, and a file in memory with the answers' bytes. Data from the other process is checked like
 * data from the network. A driver that writes to wrong addresses is one reason for the separate
 * process.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/worker_life.h"

#include <errno.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>

enum err_code worker_packet_send(int fd, const struct worker_head *h, const void *bytes, size_t n,
                                 int with, struct err *e)
{
    union {
        struct cmsghdr align;
        char bytes[CMSG_SPACE(sizeof(int))];
    } control;
    struct iovec parts[2] = {{(void *)(uintptr_t)h, sizeof *h}, {(void *)(uintptr_t)bytes, n}};
    struct msghdr m = {.msg_iov = parts, .msg_iovlen = n ? 2 : 1};
    ssize_t sent;
    if (with >= 0) {
        memset(&control, 0, sizeof control);
        m.msg_control = &control;
        m.msg_controllen = sizeof control;
        struct cmsghdr *c = CMSG_FIRSTHDR(&m);
        c->cmsg_level = SOL_SOCKET;
        c->cmsg_type = SCM_RIGHTS;
        c->cmsg_len = CMSG_LEN(sizeof(int));
        memcpy(CMSG_DATA(c), &with, sizeof with);
    }
    do
        sent = sendmsg(fd, &m, MSG_NOSIGNAL | MSG_DONTWAIT);
    while (sent < 0 && errno == EINTR);
    return sent < 0 ? err_errno(e, ERR_IO, "request") : ERR_OK;
}

enum err_code worker_packet_receive(int fd, uint64_t number, int wait_ms, struct worker_answer *a,
                                    bool *got, struct err *e)
{
    struct pollfd p = {.fd = fd, .events = POLLIN};
    *got = false;
    if (poll(&p, 1, wait_ms) <= 0)
        return ERR_OK;
    ssize_t n = recv(fd, a, sizeof *a, MSG_DONTWAIT | MSG_TRUNC);
    if (n < 0 && (errno == EINTR || errno == EAGAIN))
        return ERR_OK;
    if (n <= 0)
        return err_set(e, ERR_IO, "it has ended");
    if (n != sizeof *a || a->magic != WORKER_MAGIC || a->number != number ||
        a->code > ERR_INTERNAL || !memchr(a->text, 0, sizeof a->text))
        return err_set(e, ERR_FORMAT, "an answer that is none");
    *got = true;
    return ERR_OK;
}

enum err_code worker_packet_take(int memory, size_t n, struct buf *out, struct err *e)
{
    size_t had = out->size;
    uint8_t *to = n ? buf_grow(out, n) : NULL;
    if (n && !to)
        return err_set(e, ERR_MEM, "out of memory for %zu bytes", n);
    enum err_code rc = n ? file_read_at(memory, "an answer", to, n, 0, e) : ERR_OK;
    if (rc)
        out->size = had;
    return rc == ERR_IO ? ERR_FORMAT : rc; /* ERR_IO is of a process that has ended */
}
