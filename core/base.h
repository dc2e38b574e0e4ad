/* The small things everything else stands on: memory, byte buffers, files, log, progress, random
 * numbers, hashes, JSON with comments. Read in this order. Nothing here knows what a Gaussian is.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_BASE_H
#define CORE_BASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

#ifdef __cplusplus
extern "C" {
#endif

struct json_t;

/* ---- mem.c: sizes are multiplied here and nowhere else ---- */

/* n * size zeroed bytes, aligned to 64, or NULL (overflow, out of memory). n == 0 gives a valid
 * pointer. Free with mem_free. Tests make the k-th allocation fail with mem_fail_at(k) (0 = never).
 */
void *mem_array(size_t n, size_t size);
/* The same with anything in it: for large blocks that are written at once. */
void *mem_uninit(size_t n, size_t size);
/* Grow or shrink: contents kept up to the smaller size, new bytes zeroed. The old block stays valid
 * on failure (NULL). */
void *mem_resize(void *p, size_t n_old, size_t n_new, size_t size);
char *mem_text(const char *s); /* strdup; caller frees with mem_free; NULL when out of memory */
void mem_free(void *p);
void mem_fail_at(size_t k);
/* From now on a freed block of 256 KiB or more goes back to the system at once. glibc otherwise
 * learns from the first one that such blocks come and go and keeps them, in a heap a thread: a
 * cache of photographs filled by two threads took twice its limit. Where the C library is another
 * one, nothing happens. */
void mem_return_large(void);
/* Ask for large pages under the whole ones among these bytes: what is read here and there misses
 * fewer translations of addresses. Nothing happens below 4 MiB and where the system has none. */
void mem_prefer_huge(void *p, size_t n_bytes);
/* Peak resident set of this process so far, bytes. */
size_t mem_peak_bytes(void);
/* From now on the peak is that since now. False where the system does not do that. */
bool mem_peak_reset(void);

/* ---- arena.c: small things that die together ---- */

struct arena { /* {0} is valid and grows without limit; set limit_bytes for a ceiling */
    struct arena_block *head;
    size_t used_bytes, limit_bytes;
};
/* Zeroed, 16-byte aligned; NULL when the ceiling or memory is exhausted. Lives until arena_free. */
void *arena_get(struct arena *a, size_t n, size_t size);
char *arena_text(struct arena *a, const char *s);
char *arena_printf(struct arena *a, const char *fmt, ...) ERR_PRINTF(2, 3);
void arena_free(struct arena *a); /* idempotent, leaves {0} but for the limit */

/* ---- buf.c: a growing byte string with a sticky error ---- */

struct buf { /* {0} is valid */
    uint8_t *data;
    size_t size, cap;
    bool failed; /* an append ran out of memory; later appends do nothing; check once at the end */
};
void buf_add(struct buf *b, const void *bytes, size_t n);
void buf_u8(struct buf *b, unsigned v);
void buf_u16(struct buf *b, unsigned v); /* little-endian, as all below */
void buf_u32(struct buf *b, uint32_t v);
void buf_u64(struct buf *b, uint64_t v);
void buf_f32(struct buf *b, float v);
void buf_f64(struct buf *b, double v);
void buf_printf(struct buf *b, const char *fmt, ...)
    ERR_PRINTF(2, 3); /* no NUL counted in size, but one follows */
/* As text or a quoted attribute of HTML or XML: & < > " as entities, and no control characters that
 * XML cannot hold. NULL is no text. */
void buf_markup(struct buf *b, const char *text);
/* Make room for n more bytes and return where they go (size grows by n); NULL when out of memory.
 */
uint8_t *buf_grow(struct buf *b, size_t n);
enum err_code buf_check(const struct buf *b, struct err *e) ERR_USE; /* ERR_MEM if failed */
void buf_free(struct buf *b);

/* A reader over foreign bytes: reads past the end set `bad` and return 0, so check once per record.
 */
struct cursor {
    const uint8_t *p, *end;
    bool bad;
};
struct cursor cursor_over(const void *bytes, size_t n);
size_t cursor_left(const struct cursor *c);
const uint8_t *cursor_take(struct cursor *c, size_t n); /* NULL (and bad) when fewer are left */
uint8_t cursor_u8(struct cursor *c);
uint16_t cursor_u16(struct cursor *c);
uint32_t cursor_u32(struct cursor *c);
uint64_t cursor_u64(struct cursor *c);
float cursor_f32(struct cursor *c);
double cursor_f64(struct cursor *c);

/* ---- file.c: whole files in, whole files out ---- */

/* Read all of `path`. ERR_NOENT, ERR_IO, ERR_LIMIT (larger than limit_bytes; 0 = 8 GiB). buf_free
 * it. */
enum err_code file_read(const char *path, size_t limit_bytes, struct buf *out,
                        struct err *e) ERR_USE;
/* Write beside (`path.part-PID`), fsync, rename. On any error (ERR_IO, ERR_LIMIT) nothing is left
 * behind and an older file of that name is untouched. */
enum err_code file_write(const char *path, const void *bytes, size_t n, struct err *e) ERR_USE;
/* The same in two steps, for libraries that want a path or a stream: file_begin gives the name to
 * write to, file_commit syncs and renames it, file_abort removes it. `part` holds FILE_PATH_MAX
 * bytes. ERR_LIMIT (path too long), ERR_IO. */
enum { FILE_PATH_MAX = 4096 };
enum err_code file_begin(const char *path, char *part, struct err *e) ERR_USE;
enum err_code file_commit(const char *part, const char *path, struct err *e) ERR_USE;
void file_abort(const char *part);
/* mkdir -p. ERR_IO names the folder and why. */
enum err_code file_mkdir(const char *path, struct err *e) ERR_USE;
bool file_exists(const char *path);
bool file_is_dir(const char *path);
/* "a/b" joined into `out` (FILE_PATH_MAX bytes); ERR_LIMIT when too long. */
enum err_code file_join(char *out, const char *dir, const char *name, struct err *e) ERR_USE;
/* Names (not paths) of the regular files in `dir` with one of the suffixes (NULL-terminated list,
 * case-insensitive, NULL = all), sorted bytewise; strings live in the arena. ERR_NOENT, ERR_IO,
 * ERR_MEM. */
enum err_code file_list(const char *dir, const char *const *suffixes, struct arena *a,
                        char ***names, size_t *n, struct err *e) ERR_USE;

/* ---- log.c ---- */

enum log_level { LOG_ERROR, LOG_WARN, LOG_INFO, LOG_DEBUG };
void log_set_level(enum log_level level); /* before threads start */
/* Lines of JSON instead: {"ts","level","module","msg"}. Before threads start. */
void log_set_json(bool json);
bool log_is_json(void);
/* Now in UTC, as RFC 3339 writes it, with milliseconds. */
void log_now(char out[32]);
/* text as the inside of a JSON string, with a NUL; cut where `room` ends. Returns its length. */
size_t log_quote(const char *text, char *out, size_t room);
/* One line on stderr: "12.41 info train step n=1200 loss=0.0812": elapsed, level, module, event and
 * key=value pairs with units in the keys. */
void log_line(enum log_level level, const char *module, const char *fmt, ...) ERR_PRINTF(3, 4);
/* The same in two steps, for those who gather many lines: the length of the line composed with its
 * newline (0: the level is off), and bytes to stderr as they are. */
size_t log_compose(char *line, size_t room, enum log_level level, const char *module,
                   const char *fmt, ...) ERR_PRINTF(5, 6);
void log_write(const char *lines, size_t n);
/* From here on lines go through a bounded queue to a thread of their own, so that a reader of
 * stderr who stops holds up nobody; what does not fit is dropped and counted. Before other threads
 * start. ERR_MEM. */
enum err_code log_start(struct err *e) ERR_USE;
/* Write what waits, for at most wait_s; then lines are written by who logs them again, unless
 * stderr still hangs. After other threads have ended. */
void log_stop(double wait_s);
#define log_error(module, ...) log_line(LOG_ERROR, module, __VA_ARGS__)
#define log_warn(module, ...) log_line(LOG_WARN, module, __VA_ARGS__)
#define log_info(module, ...) log_line(LOG_INFO, module, __VA_ARGS__)
#define log_debug(module, ...) log_line(LOG_DEBUG, module, __VA_ARGS__)

/* ---- progress.c: long work tells its rate and the time left ---- */

struct progress {     /* one thread updates it */
    const char *what; /* borrowed for the lifetime, "train level 1" */
    uint64_t total, done;
    double start_s, last_s;
    bool tty, active;
};
void progress_start(struct progress *p, const char *what, uint64_t total);
/* `note` (may be NULL) is appended: "loss 0.08, 41 k Gaussians". Cheap: prints at most 10 times a
 * second on a terminal, one line every 5 s otherwise. */
void progress_step(struct progress *p, uint64_t done, const char *note);
void progress_end(struct progress *p, const char *note);
void progress_quiet(bool quiet); /* -q: no bars at all; before threads start */

/* ---- clock.c: clock and stop flag ---- */

double clock_s(void);     /* monotonic seconds */
double clock_cpu_s(void); /* CPU seconds of the whole process, all threads */

/* ---- signals.c: the stop flag ---- */

/* SIGINT and SIGTERM set the flag; a second one kills. Before threads start. */
void signals_catch(void);
/* Was it set? Any thread. */
bool signals_stopping(void);

/* ---- rng.c: counter-based, so that the order of threads cannot matter ---- */

/* 64 random bits of (seed, stream, index): the same on every machine and in any order. */
uint64_t rng_u64(uint64_t seed, uint64_t stream, uint64_t index);
double rng_unit(uint64_t seed, uint64_t stream, uint64_t index); /* uniform in [0, 1), 53 bits */
double rng_normal(uint64_t seed, uint64_t stream,
                  uint64_t index); /* standard normal (Box-Muller) */

/* ---- hash.c: XXH3-128 (libxxhash) ---- */

struct hash128 {
    uint64_t lo, hi;
};
struct hash128 hash_bytes(const void *bytes, size_t n);
/* The same over bytes that come piece by piece. hash_end frees the state (NULL: out of memory at
 * the start, and everything is a no-op that ends in zeros). */
struct hash_state;
struct hash_state *hash_begin(void);
void hash_add(struct hash_state *s, const void *bytes, size_t n);
struct hash128 hash_end(struct hash_state *s);
void hash_text(struct hash128 h, char out[33]); /* 32 lower-case hex digits and NUL */

/* ---- jsonc.c: JSON with whole-line // comments, by jansson ---- */

/* Load and parse; duplicate keys are refused, errors name file, line and column. json_decref it.
 * ERR_FORMAT, ERR_MEM; of a file also ERR_NOENT, ERR_IO, ERR_LIMIT. */
enum err_code jsonc_read(const char *path, struct json_t **out, struct err *e) ERR_USE;
enum err_code jsonc_parse(const char *text, size_t n, const char *name, struct json_t **out,
                          struct err *e) ERR_USE;
/* Write through file_write, indented by 2, numbers with 17 digits, keys in insertion order.
 * ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code jsonc_write(const char *path, const struct json_t *json, struct err *e) ERR_USE;
/* Typed members, ERR_FORMAT "NAME: key: expected number" when missing or of another type. */
enum err_code jsonc_num(const struct json_t *o, const char *key, double *out,
                        struct err *e) ERR_USE;
enum err_code jsonc_nums(const struct json_t *o, const char *key, size_t n, double *out,
                         struct err *e) ERR_USE;
enum err_code jsonc_text(const struct json_t *o, const char *key, const char **out,
                         struct err *e) ERR_USE; /* borrowed from o */
/* A number to write, for json_pack's "o": null where it is not finite, which JSON cannot say. */
struct json_t *jsonc_real(double v);

#ifdef __cplusplus
}
#endif
#endif
