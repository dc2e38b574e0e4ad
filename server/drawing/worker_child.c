/* The other side of worker_ask.c: the process that answers.
 *
 * Requests come as packets on descriptor 3, one at a time. The bytes of answers go to a file in
 * memory that the other process reads; its descriptor came with the first request. The process ends
 * when the other side has gone: it sees the end of the connection, and if it is in a call that does
 * not return, the kernel kills it. The parent blocks signals that a terminal or a supervisor sends
 * to a whole group, so that work in progress is finished first.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): close_range
#include "server/drawing/worker.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sysexits.h>
#include <unistd.h>

static struct { /* of the one connection that this process has */
    uint8_t request[WORKER_REQUEST_MAX];
    size_t n;
    int memory;         /* file of the answers */
    uint64_t number;    /* of the request under way */
    uint64_t had_bytes; /* of the answer before */
    bool there;         /* this process is that one */
    bool cancelled, ended, leaves;
    double start_s;
    struct worker_part span[WORKER_SPANS]; /* of the answer under way */
    uint32_t n_spans;
} worker_child;

bool worker_asked(int argc, char **argv)
{
    return argc == 2 && !strcmp(argv[1], WORKER_ARGUMENT);
}

/* One packet; *with: a descriptor that came along, -1 if none did. False: nobody is there. */
static bool worker_child_receive(struct worker_head *h, void *bytes, size_t room, size_t *n,
                                 int *with)
{
    union {
        struct cmsghdr align;
        char bytes[CMSG_SPACE(sizeof(int))];
    } control;
    struct iovec parts[2] = {{h, sizeof *h}, {bytes, room}};
    struct msghdr m = {.msg_iov = parts,
                       .msg_iovlen = 2,
                       .msg_control = &control,
                       .msg_controllen = sizeof control};
    ssize_t got;
    do
        got = recvmsg(WORKER_FD, &m, MSG_CMSG_CLOEXEC);
    while (got < 0 && errno == EINTR);
    if (got < (ssize_t)sizeof *h || h->magic != WORKER_MAGIC || (m.msg_flags & MSG_TRUNC))
        return false;
    const struct cmsghdr *c = CMSG_FIRSTHDR(&m);
    *n = (size_t)got - sizeof *h;
    *with = -1;
    if (c && c->cmsg_level == SOL_SOCKET && c->cmsg_type == SCM_RIGHTS)
        memcpy(with, CMSG_DATA(c), sizeof *with);
    return true;
}

/* The next request, what was said about those before passed over. */
static bool worker_child_next(int *with)
{
    struct worker_head h;
    while (!worker_child.ended) {
        if (!worker_child_receive(&h, worker_child.request, sizeof worker_child.request,
                                  &worker_child.n, with))
            return false;
        if (h.cancel)
            continue;
        worker_child.number = h.number;
        worker_child.cancelled = false;
        return true;
    }
    return false;
}

bool worker_cancelled(const void *user)
{
    struct pollfd p = {.fd = WORKER_FD, .events = POLLIN};
    struct worker_head h;
    size_t n;
    int with;
    (void)user;
    while (worker_child.there && !worker_child.cancelled && poll(&p, 1, 0) > 0) {
        worker_child.ended = !worker_child_receive(&h, NULL, 0, &n, &with);
        worker_child.cancelled = worker_child.ended || h.number == worker_child.number;
    }
    return worker_child.cancelled;
}

/* The bytes into the file, which is cut first where it was longer: pictures are of many sizes. */
static enum err_code worker_child_put(const struct buf *b, struct err *e)
{
    static const char what[] = "picture: no memory to hand it over";
    if (b->size < worker_child.had_bytes && ftruncate(worker_child.memory, (off_t)b->size))
        return err_errno(e, ERR_MEM, "%s", what);
    worker_child.had_bytes = b->size;
    for (size_t at = 0; at < b->size;) {
        ssize_t n = pwrite(worker_child.memory, b->data + at, b->size - at, (off_t)at);
        if (n <= 0 && errno != EINTR)
            return err_errno(e, ERR_MEM, "%s", what);
        at += n > 0 ? (size_t)n : 0;
    }
    return ERR_OK;
}

void worker_span(uint32_t what, double from_s, double to_s)
{
    if (worker_child.there && worker_child.n_spans < WORKER_SPANS)
        worker_child.span[worker_child.n_spans++] = (struct worker_part){what, from_s, to_s};
}

static bool worker_child_answer(enum err_code rc, const char *text, size_t n_bytes)
{
    struct worker_answer a = {.magic = WORKER_MAGIC,
                              .code = rc,
                              .leaves = worker_child.leaves,
                              .n_spans = worker_child.n_spans,
                              .number = worker_child.number,
                              .n_bytes = n_bytes,
                              .peak_bytes = mem_peak_bytes(),
                              .cpu_s = clock_cpu_s(),
                              .sent_s = clock_s()};
    memcpy(a.span, worker_child.span, sizeof a.span);
    worker_child.n_spans = 0;
    snprintf(a.text, sizeof a.text, "%s", text);
    return send(WORKER_FD, &a, sizeof a, MSG_NOSIGNAL) == (ssize_t)sizeof a;
}

static bool worker_child_run(const struct worker_service *s, void *user, int with)
{
    struct err e = {0};
    struct buf out = {0};
    enum err_code rc = s->run(user, worker_child.request, worker_child.n, with, &out, &e);
    if (!rc)
        rc = buf_check(&out, &e);
    if (!rc)
        rc = worker_child_put(&out, &e);
    bool told = worker_child_answer(rc, e.msg, rc ? 0 : out.size);
    buf_free(&out);
    return told;
}

/* Where memory runs out, this process goes rather than the one that serves tiles. */
static void worker_child_offer(void)
{
    FILE *f = fopen("/proc/self/oom_score_adj", "we");
    if (!f)
        return;
    fputs("500\n", f);
    fclose(f);
}

int worker_main(const struct worker_service *s)
{
    struct err e = {0};
    char about[WORKER_ABOUT] = "";
    void *user = NULL;
    int with = -1, type = 0;
    socklen_t n_type = sizeof type;
    if (getsockopt(WORKER_FD, SOL_SOCKET, SO_TYPE, &type, &n_type) || type != SOCK_SEQPACKET) {
        fprintf(stderr, "citysplat: error: %s is for `citysplat serve` alone\n", WORKER_ARGUMENT);
        return EX_USAGE;
    }
    worker_child.there = true;
    worker_child.start_s = clock_s();
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    (void)close_range(WORKER_FD + 1, ~0U, 0);
    worker_child_offer();
    if (!worker_child_next(&worker_child.memory) || worker_child.memory < 0)
        return EX_PROTOCOL;
    enum err_code rc = s->open(worker_child.request, worker_child.n, &user, about, &e);
    bool told = worker_child_answer(rc, rc ? e.msg : about, 0);
    while (!rc && told && worker_child_next(&with)) {
        told = worker_child_run(s, user, with) && !worker_child.leaves;
        if (told && s->rest && s->rest(user))
            worker_child.leaves = clock_s() - worker_child.start_s >= s->age_s;
    }
    s->close(user);
    return rc ? EX_UNAVAILABLE : EX_OK;
}
