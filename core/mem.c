/* Memory. Every size is multiplied here, with a check for overflow. Blocks are aligned to 64 bytes
 * for vector loads. Tests use the failure counter to make each allocation fail in turn.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _DEFAULT_SOURCE /* madvise */
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include "core/base.h"

enum { MEM_ALIGN = 64, MEM_LARGE = 256 << 10, MEM_HUGE = 2 << 20 };
static atomic_size_t mem_countdown;                                /* 0 = never fail */
static pthread_mutex_t mem_short_lock = PTHREAD_MUTEX_INITIALIZER; /* of the next two */
static void (*mem_short_yield)(void *user, size_t bytes);
static void *mem_short_user;

void mem_fail_at(size_t k)
{
    atomic_store(&mem_countdown, k);
}

static bool mem_must_fail(void)
{
    size_t k = atomic_load(&mem_countdown);
    while (k > 0)
        if (atomic_compare_exchange_weak(&mem_countdown, &k, k - 1))
            return k == 1;
    return false;
}

/* Bytes rounded up to the alignment, or 0 on overflow. */
static size_t mem_round(size_t n, size_t size)
{
    if (size && n > (SIZE_MAX - 2 * MEM_ALIGN) / size)
        return 0;
    size_t bytes = n * size;
    return bytes ? (bytes + MEM_ALIGN - 1) / MEM_ALIGN * MEM_ALIGN : MEM_ALIGN;
}

void mem_on_short(void (*yield)(void *user, size_t bytes), void *user)
{
    pthread_mutex_lock(&mem_short_lock);
    mem_short_yield = yield;
    mem_short_user = user;
    pthread_mutex_unlock(&mem_short_lock);
}

/* Under the lock, so that whoever takes `yield` away knows that it is not running. */
static bool mem_make_room(size_t bytes)
{
    pthread_mutex_lock(&mem_short_lock);
    const bool asked = mem_short_yield;
    if (asked)
        mem_short_yield(mem_short_user, bytes);
    pthread_mutex_unlock(&mem_short_lock);
    return asked;
}

static bool mem_allocate(void **p, size_t bytes)
{
    return !mem_must_fail() && !posix_memalign(p, MEM_ALIGN, bytes);
}

void *mem_uninit(size_t n, size_t size)
{
    size_t bytes = mem_round(n, size);
    void *p = NULL;
    if (!bytes || (!mem_allocate(&p, bytes) && !(mem_make_room(bytes) && mem_allocate(&p, bytes))))
        return NULL;
    mem_prefer_huge(p, bytes);
    return p;
}

void *mem_array(size_t n, size_t size)
{
    void *p = mem_uninit(n, size);
    return p ? memset(p, 0, mem_round(n, size)) : NULL;
}

void *mem_resize(void *p, size_t n_old, size_t n_new, size_t size)
{
    void *q = mem_array(n_new, size);
    if (!q)
        return NULL;
    if (p) {
        memcpy(q, p, (n_old < n_new ? n_old : n_new) * size);
        mem_free(p);
    }
    return q;
}

void *mem_room(void *p, size_t n, size_t *cap, size_t first, size_t size)
{
    if (n < *cap)
        return p;
    size_t more = *cap ? (*cap <= SIZE_MAX / 2 ? 2 * *cap : SIZE_MAX) : first;
    void *q = mem_resize(p, *cap, more, size);
    if (q)
        *cap = more;
    return q;
}

char *mem_text(const char *s)
{
    size_t n = strlen(s) + 1;
    char *p = mem_array(n, 1);
    if (p)
        memcpy(p, s, n);
    return p;
}

void mem_free(void *p)
{
    free(p);
}

void mem_return_large(void)
{
#ifdef __GLIBC__
    (void)mallopt(M_MMAP_THRESHOLD, MEM_LARGE);
#endif
}

void mem_give_back(void)
{
#ifdef __GLIBC__
    (void)malloc_trim(0);
#endif
}

size_t mem_held_bytes(int pid)
{
    char path[48], line[128];
    unsigned long long kb, held_kb = 0;
    if (pid)
        snprintf(path, sizeof path, "/proc/%d/status", pid);
    FILE *f = fopen(pid ? path : "/proc/self/status", "re");
    while (f && fgets(line, sizeof line, f))
        if (sscanf(line, "RssAnon: %llu", &kb) == 1 || sscanf(line, "RssShmem: %llu", &kb) == 1)
            held_kb += kb;
    if (f)
        fclose(f);
    return (size_t)held_kb << 10;
}

bool mem_peak_reset(void)
{
    bool done = false;
#ifdef __linux__
    FILE *f = fopen("/proc/self/clear_refs", "w"); /* proc(5): 5 resets the peak of the process */
    if (f) {
        done = fputs("5", f) >= 0;
        done = fclose(f) == 0 && done;
    }
#endif
    return done;
}

void mem_prefer_huge(void *p, size_t n_bytes)
{
#ifdef MADV_HUGEPAGE
    if (!p || n_bytes < 2 * MEM_HUGE)
        return;
    uintptr_t from = ((uintptr_t)p + MEM_HUGE - 1) / MEM_HUGE * MEM_HUGE;
    uintptr_t to = ((uintptr_t)p + n_bytes) / MEM_HUGE * MEM_HUGE;
    if (to > from)
        (void)madvise((void *)from, to - from, MADV_HUGEPAGE); /* advice may be declined */
#else
    (void)p;
    (void)n_bytes;
#endif
}

size_t mem_peak_bytes(void)
{
    struct rusage u;
    if (getrusage(RUSAGE_SELF, &u))
        return 0;
    return (size_t)u.ru_maxrss * 1024;
}
