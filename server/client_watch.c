/* Ends connections of clients that are slow, idle or gone. libmicrohttpd's timeout counts
 * inactivity, so it never ends a client that sends one byte a second. It does not look at suspended
 * connections, so it does not notice a client that hangs up while its tile is made. This thread
 * does both. Each connection has a slot with a deadline for its present phase (an atomic, so
 * requests take no lock). The sockets of waiting clients are in an epoll set.
 *
 * A slot's fd is valid from client_watch_add to client_watch_remove, which libmicrohttpd calls
 * before it closes the socket. shutdown() under the lock therefore never hits a reused number. A
 * waiter is used only while the slot is armed and the lock is held. Code that resumes a connection
 * disarms the slot first.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/client_watch.h"

#include <errno.h>
#include <linux/tcp.h>
#include <netinet/in.h>
#include <poll.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "core/pool.h"
#include "server/answers/view_stream.h"

enum { TICK_MS = 100, GONE_MS = 250, EVENTS = 64, POLLED = 256 };
/* A request that is not complete, and an answer that is not read, after this long are slow enough
 * to give way to another connection. */
enum { HEAD_SLOW_MS = 500, SEND_SLOW_MS = 2000 };
enum { TALLIES = 4096 };
enum { POLL_GONE = 0x2000 }; /* POLLRDHUP, which Linux has and POSIX does not */
enum arm { ARM_EXPECTED, ARM_ON, ARM_OFF };

struct client_watch_slot {
    int fd; /* -1 when free; this line and the next by the lock */
    uint32_t generation, next_free;
    enum arm arm;
    struct job_waiter *waiter;
    struct view_stream *stream;   /* in place of a waiter; borrowed while armed */
    uint64_t client;              /* this line and the next by the lock */
    bool displaced;               /* it was ended for another: counts no more */
    _Atomic uint64_t since_ms;    /* of its phase */
    _Atomic uint64_t deadline_ms; /* 0 = none */
    uint64_t acked;               /* bytes that the client had when the window began; this line and
                                     the next by the lock */
    uint64_t window;              /* deadline that `acked` belongs to; another one: a new answer */
    _Atomic int phase;
    _Atomic uint32_t requests;
};
struct client_watch {
    struct services *s;
    void (*gone)(struct job_waiter *w);
    pthread_mutex_t lock;
    struct client_watch_slot *slot;
    uint32_t n, used, first_free; /* used: slots ever taken; first_free: n = none */
    size_t most, n_open;          /* connections; these by the lock */
    uint32_t tally[TALLIES];      /* of n_open, by client: an upper bound of its connections */
    int epoll_fd;
    struct pool_thread *thread;
    _Atomic bool stop;
};

static uint64_t client_watch_now_ms(void)
{
    return (uint64_t)(clock_s() * 1000);
}

/* ---- the thread ---- */

/* The client behind this slot hung up, or closed its sending half. A half-closed client may still
 * read (RFC 9112, section 9.6), and a tile is soon made and worth keeping, so only a picture is
 * given up for that. */
static void client_watch_on_event(struct client_watch *w, uint64_t id, uint32_t events)
{
    struct job_waiter *left = NULL;
    struct view_stream *ended = NULL;
    uint32_t index = (uint32_t)id, generation = (uint32_t)(id >> 32);
    pthread_mutex_lock(&w->lock);
    struct client_watch_slot *s = &w->slot[index];
    if (s->fd >= 0 && s->generation == generation && s->arm == ARM_ON) {
        bool half = !(events & (EPOLLHUP | EPOLLERR));
        struct epoll_event again = {.events = EPOLLONESHOT, .data.u64 = id};
        if (s->stream)
            ended = view_stream_ref(s->stream);
        else if (half && !job_is_picture(job_class_of(w->s->jobs, s->waiter)))
            (void)epoll_ctl(w->epoll_fd, EPOLL_CTL_MOD, s->fd, &again);
        else if (job_leave(w->s->jobs, s->waiter))
            left = s->waiter;
    }
    pthread_mutex_unlock(&w->lock);
    if (left)
        w->gone(left);
    if (ended) {
        view_stream_end(ended);
        view_stream_drop(&ended);
    }
}

/* Bytes that the client's side has taken over the life of the connection. */
static uint64_t client_watch_acked(int fd)
{
    struct tcp_info info = {0};
    socklen_t n = sizeof info;
    return getsockopt(fd, IPPROTO_TCP, TCP_INFO, &info, &n) ? 0 : info.tcpi_bytes_acked;
}

/* An answer that is being sent goes on as long as it moves: the client must have taken min_rate_kb
 * a second since the last look, write_timeout_s ago. Answers that are out between two ticks are
 * never looked at. True when the client is too slow. */
static bool client_watch_stalls(struct client_watch *w, struct client_watch_slot *s,
                                uint64_t deadline, uint64_t now)
{
    const struct server_config *cfg = w->s->cfg;
    uint64_t window_ms = (uint64_t)(cfg->write_timeout_s * 1000) + 1;
    uint64_t acked = client_watch_acked(s->fd);
    if (s->window != deadline) { /* first look at this answer */
        s->window = deadline;
        s->acked = acked;
        return false;
    }
    if (now < deadline)
        return false;
    uint64_t want = (uint64_t)((double)cfg->min_rate_kb * 1.024 * (double)window_ms);
    if (acked - s->acked < want || acked == s->acked)
        return true;
    s->window = now + window_ms;
    s->acked = acked;
    atomic_compare_exchange_strong(&s->deadline_ms, &deadline, s->window); /* or it is out by now */
    return false;
}

static void client_watch_reap(struct client_watch *w)
{
    uint64_t now = client_watch_now_ms();
    pthread_mutex_lock(&w->lock);
    for (uint32_t i = 0; i < w->used; i++) {
        struct client_watch_slot *s = &w->slot[i];
        uint64_t deadline = atomic_load_explicit(&s->deadline_ms, memory_order_relaxed);
        if (s->fd < 0 || !deadline)
            continue;
        bool sending = atomic_load(&s->phase) == CLIENT_WATCH_SEND;
        if (sending ? !client_watch_stalls(w, s, deadline, now) : now < deadline)
            continue;
        if (atomic_load(&s->phase) != CLIENT_WATCH_IDLE)
            atomic_fetch_add(&w->s->metrics.reaped, 1);
        atomic_store(&s->deadline_ms, 0);
        shutdown(s->fd, SHUT_RDWR);
    }
    pthread_mutex_unlock(&w->lock);
}

/* libmicrohttpd listens edge-triggered, and misses a client that closes just as its answer goes
 * out. Idle connections whose client is gone would then be kept until the idle timeout. */
static void client_watch_close_gone(struct client_watch *w)
{
    struct pollfd p[POLLED];
    nfds_t n = 0;
    pthread_mutex_lock(&w->lock);
    for (uint32_t i = 0; i < w->used; i++) {
        struct client_watch_slot *s = &w->slot[i];
        if (s->fd >= 0 && atomic_load(&s->phase) == CLIENT_WATCH_IDLE)
            p[n++] = (struct pollfd){.fd = s->fd, .events = POLL_GONE};
        if (n < POLLED && i + 1 < w->used)
            continue;
        if (poll(p, n, 0) > 0)
            for (nfds_t k = 0; k < n; k++)
                if (p[k].revents & (POLL_GONE | POLLHUP | POLLERR))
                    shutdown(p[k].fd, SHUT_RDWR);
        n = 0;
    }
    pthread_mutex_unlock(&w->lock);
}

static void client_watch_main(void *user)
{
    struct client_watch *w = user;
    uint64_t next = client_watch_now_ms(), next_gone = next;
    while (!atomic_load(&w->stop)) {
        struct epoll_event event[EVENTS];
        int n = epoll_wait(w->epoll_fd, event, EVENTS, TICK_MS);
        for (int i = 0; i < n; i++)
            client_watch_on_event(w, event[i].data.u64, event[i].events);
        if (client_watch_now_ms() < next)
            continue;
        next = client_watch_now_ms() + TICK_MS;
        client_watch_reap(w);
        job_tick(w->s->jobs, clock_s());
        view_stream_tick(w->s->view_streams, clock_s());
        if (w->s->access)
            access_log_flush(w->s->access);
        if (client_watch_now_ms() >= next_gone) {
            client_watch_close_gone(w);
            next_gone = client_watch_now_ms() + GONE_MS;
        }
    }
}

/* ---- the interface ---- */

enum err_code client_watch_open(size_t most, struct services *s, void (*gone)(struct job_waiter *w),
                                struct client_watch **out, struct err *e)
{
    struct client_watch *w = mem_array(1, sizeof *w);
    size_t limit = most * 2 + 128; /* those over the limit as well */
    *out = w;
    if (!w || !(w->slot = mem_array(limit, sizeof *w->slot))) {
        mem_free(w);
        *out = NULL;
        return err_set(e, ERR_MEM, "watch: out of memory for %zu connections", limit);
    }
    w->s = s;
    w->gone = gone;
    w->most = most;
    w->n = w->first_free = (uint32_t)limit;
    pthread_mutex_init(&w->lock, NULL);
    w->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    enum err_code rc = w->epoll_fd < 0 ? err_errno(e, ERR_IO, "watch: epoll_create1") : ERR_OK;
    if (!rc)
        rc = pool_start(client_watch_main, w, &w->thread, e);
    if (rc)
        client_watch_close(out);
    return rc;
}

void client_watch_close(struct client_watch **out)
{
    struct client_watch *w = *out;
    *out = NULL;
    if (!w)
        return;
    atomic_store(&w->stop, true);
    if (w->thread)
        pool_join(&w->thread);
    if (w->epoll_fd >= 0)
        close(w->epoll_fd);
    pthread_mutex_destroy(&w->lock);
    mem_free(w->slot);
    mem_free(w);
}

/* ---- who gives way ---- */

static void client_watch_uncount(struct client_watch *w, struct client_watch_slot *s)
{
    w->n_open--;
    w->tally[s->client % TALLIES]--;
}

/* How easily a connection gives way: 0 not at all, else the more the longer it has been idle, or
 * slow. Whoever waits for a job, or is being answered, keeps its place. */
static uint64_t client_watch_ease(const struct client_watch_slot *s, uint64_t now)
{
    uint64_t since = atomic_load_explicit(&s->since_ms, memory_order_relaxed);
    uint64_t age = since && now > since ? now - since : 0;
    switch (atomic_load_explicit(&s->phase, memory_order_relaxed)) {
    case CLIENT_WATCH_IDLE:
        return age + 1;
    case CLIENT_WATCH_HEADER:
    case CLIENT_WATCH_BODY:
        return age > HEAD_SLOW_MS ? age : 0;
    case CLIENT_WATCH_SEND:
        return age > SEND_SLOW_MS ? age : 0;
    default:
        return 0;
    }
}

/* End the connection that gives way most easily among those of a client, or of all whose tally is
 * this one. False: none does. */
static bool client_watch_displace(struct client_watch *w, bool one_client, uint64_t client)
{
    uint64_t now = client_watch_now_ms(), most = 0;
    struct client_watch_slot *victim = NULL;
    for (uint32_t i = 0; i < w->used; i++) {
        struct client_watch_slot *s = &w->slot[i];
        bool own = one_client ? s->client == client : s->client % TALLIES == client % TALLIES;
        if (s->fd < 0 || s->displaced || !own)
            continue;
        uint64_t ease = client_watch_ease(s, now);
        if (ease > most) {
            most = ease;
            victim = s;
        }
    }
    if (!victim)
        return false;
    /* A request that has come to an idle one just now is still read and answered. */
    bool idle = atomic_load_explicit(&victim->phase, memory_order_relaxed) == CLIENT_WATCH_IDLE;
    victim->displaced = true;
    client_watch_uncount(w, victim);
    shutdown(victim->fd, idle ? SHUT_RD : SHUT_RDWR);
    atomic_fetch_add(&w->s->metrics.displaced, 1);
    return true;
}

static size_t client_watch_count(const struct client_watch *w, uint64_t client)
{
    size_t n = 0;
    for (uint32_t i = 0; i < w->used; i++)
        n += w->slot[i].fd >= 0 && !w->slot[i].displaced && w->slot[i].client == client;
    return n;
}

/* Room for one more connection of a client. */
static bool client_watch_make_room(struct client_watch *w, uint64_t client, size_t limit)
{
    if (limit && w->tally[client % TALLIES] >= limit && client_watch_count(w, client) >= limit)
        return client_watch_displace(w, true, client);
    if (w->n_open < w->most)
        return true;
    uint64_t most = 0;
    for (uint64_t i = 1; i < TALLIES; i++)
        most = w->tally[i] > w->tally[most] ? i : most;
    return client_watch_displace(w, false, most);
}

struct client_watch_slot *client_watch_add(struct client_watch *w, int fd, uint64_t client,
                                           size_t limit, bool *over)
{
    struct client_watch_slot *s = NULL;
    pthread_mutex_lock(&w->lock);
    *over = !client_watch_make_room(w, client, limit);
    if (w->first_free < w->n) {
        s = &w->slot[w->first_free];
        w->first_free = s->next_free;
    } else if (w->used < w->n) {
        s = &w->slot[w->used++];
    }
    if (s) {
        s->fd = fd;
        s->generation++;
        s->arm = ARM_OFF;
        s->waiter = NULL;
        s->client = client;
        s->displaced = *over; /* it is answered and closed: it takes nobody's place */
        w->n_open += !*over;
        w->tally[client % TALLIES] += !*over;
        atomic_store(&s->phase,
                     CLIENT_WATCH_HEADER); /* not idle for long, as who had the slot before */
        atomic_store(&s->since_ms, client_watch_now_ms());
        atomic_store(&s->deadline_ms, 0);
        atomic_store(&s->requests, 0);
    }
    pthread_mutex_unlock(&w->lock);
    return s;
}

void client_watch_remove(struct client_watch *w, struct client_watch_slot *s)
{
    if (!s)
        return;
    client_watch_disarm(w, s);
    pthread_mutex_lock(&w->lock);
    s->fd = -1;
    if (!s->displaced)
        client_watch_uncount(w, s);
    s->next_free = w->first_free;
    w->first_free = (uint32_t)(s - w->slot);
    pthread_mutex_unlock(&w->lock);
}

void client_watch_phase(struct client_watch_slot *s, enum client_watch_phase phase,
                        double timeout_s)
{
    client_watch_phase_at(s, phase, timeout_s, timeout_s > 0 ? clock_s() : 0);
}

void client_watch_phase_at(struct client_watch_slot *s, enum client_watch_phase phase,
                           double timeout_s, double now_s)
{
    if (!s)
        return;
    uint64_t now = timeout_s > 0 ? (uint64_t)(now_s * 1000) : 0;
    atomic_store_explicit(&s->phase, phase, memory_order_relaxed);
    atomic_store_explicit(&s->since_ms, now, memory_order_relaxed);
    atomic_store_explicit(&s->deadline_ms, now ? now + (uint64_t)(timeout_s * 1000) + 1 : 0,
                          memory_order_relaxed);
}

uint32_t client_watch_requests(struct client_watch_slot *s)
{
    return s ? atomic_fetch_add_explicit(&s->requests, 1, memory_order_relaxed) + 1 : 1;
}

void client_watch_expect(struct client_watch *w, struct client_watch_slot *s)
{
    if (!s)
        return;
    pthread_mutex_lock(&w->lock);
    s->arm = ARM_EXPECTED;
    pthread_mutex_unlock(&w->lock);
}

/* Under the lock. */
static void client_watch_arm_slot(struct client_watch *w, struct client_watch_slot *s,
                                  struct job_waiter *waiter, struct view_stream *st)
{
    struct epoll_event event = {
        .events = EPOLLRDHUP | EPOLLONESHOT,
        .data.u64 = (uint64_t)s->generation << 32 | (uint64_t)(s - w->slot),
    };
    if (epoll_ctl(w->epoll_fd, EPOLL_CTL_ADD, s->fd, &event) == 0) {
        s->arm = ARM_ON;
        s->waiter = waiter;
        s->stream = st;
    }
}

void client_watch_arm(struct client_watch *w, struct client_watch_slot *s,
                      struct job_waiter *waiter)
{
    if (!s)
        return;
    pthread_mutex_lock(&w->lock);
    if (s->arm == ARM_EXPECTED) /* else the job has ended already, and the waiter with it */
        client_watch_arm_slot(w, s, waiter, NULL);
    pthread_mutex_unlock(&w->lock);
}

void client_watch_arm_stream(struct client_watch *w, struct client_watch_slot *s,
                             struct view_stream *st)
{
    if (!s)
        return;
    pthread_mutex_lock(&w->lock);
    client_watch_arm_slot(w, s, NULL, st);
    pthread_mutex_unlock(&w->lock);
}

void client_watch_disarm(struct client_watch *w, struct client_watch_slot *s)
{
    if (!s)
        return;
    pthread_mutex_lock(&w->lock);
    if (s->arm == ARM_ON)
        (void)epoll_ctl(w->epoll_fd, EPOLL_CTL_DEL, s->fd, NULL);
    s->arm = ARM_OFF;
    s->waiter = NULL;
    s->stream = NULL;
    pthread_mutex_unlock(&w->lock);
}

void client_watch_stop_idle(struct client_watch *w)
{
    pthread_mutex_lock(&w->lock);
    for (uint32_t i = 0; i < w->used; i++) {
        struct client_watch_slot *s = &w->slot[i];
        /* Reading half only: a request that arrived just now is still read, and answered. */
        if (s->fd >= 0 && atomic_load(&s->phase) == CLIENT_WATCH_IDLE)
            shutdown(s->fd, SHUT_RD);
    }
    pthread_mutex_unlock(&w->lock);
}
