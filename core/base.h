/* Basic services of all other files: memory, byte buffers, files, log, progress, random numbers,
 * hashes, JSON with comments. Nothing here knows what a Gaussian is.
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

/* ---- mem.c: the only place where sizes are multiplied ---- */

/* Returns n * size zeroed bytes, aligned to 64, or NULL if that overflows or memory is short. n ==
 * 0 gives a valid pointer. The caller frees it with mem_free. Tests make the k-th allocation fail
 * with mem_fail_at(k); 0 turns that off. */
void *mem_array(size_t n, size_t size);
/* As mem_array, but the bytes are not zeroed. Use it for large blocks that are written at once. */
void *mem_uninit(size_t n, size_t size);
/* Grows or shrinks a block. Contents are kept up to the smaller size, and new bytes are zeroed. On
 * failure it returns NULL, and the old block stays valid. */
void *mem_resize(void *p, size_t n_old, size_t n_new, size_t size);
/* Makes room for one more element in a list of n, which has room for *cap. Returns the list. If it
 * is full it grows to `first` elements at first, then to twice as many. NULL: out of memory; the
 * old list and *cap stay valid. */
void *mem_room(void *p, size_t n, size_t *cap, size_t first, size_t size);
char *mem_text(const char *s); /* as strdup; caller frees with mem_free; NULL: out of memory */
void mem_free(void *p);
void mem_fail_at(size_t k);
/* From now on, freed blocks of at least 256 KiB go back to the system at once. By default glibc
 * raises that threshold as large blocks are freed, and keeps the freed blocks of each thread in a
 * heap of its own. A cache of photographs that two threads filled therefore took twice its limit.
 * With another C library nothing changes. */
void mem_return_large(void);
/* Gives back to the system what the program has freed but the C library still holds. This takes
 * milliseconds, and threads that allocate wait meanwhile. With another C library nothing happens.
 */
void mem_give_back(void);
/* Returns how many bytes a process holds that the system cannot drop without swap: its anonymous
 * and shared pages. pid 0: this process. 0: not known. */
size_t mem_held_bytes(int pid);
/* Sets the function that is called when an allocation fails; the allocation is then tried once
 * more. `yield` frees memory that can be spared. It must neither allocate nor wait for a lock that
 * an allocating thread may hold. NULL: no function is called. */
void mem_on_short(void (*yield)(void *user, size_t bytes), void *user);
/* Asks the system for large pages where the block covers whole ones. Scattered reads then cause
 * fewer TLB misses. Nothing happens for less than 4 MiB, or where the system has no large pages. */
void mem_prefer_huge(void *p, size_t n_bytes);
/* Peak resident set of this process, in bytes. 0: not known. */
size_t mem_peak_bytes(void);
/* Restarts the measurement of mem_peak_bytes. Returns false where the system cannot do that. */
bool mem_peak_reset(void);

/* ---- arena.c: small allocations that are freed together ---- */

struct arena { /* {0} is valid and grows without limit; limit_bytes sets a limit */
    struct arena_block *head;
    size_t used_bytes, limit_bytes;
};
/* Returns zeroed bytes, aligned to 16, or NULL at the limit or when memory is short. They live
 * until arena_free. */
void *arena_get(struct arena *a, size_t n, size_t size);
char *arena_text(struct arena *a, const char *s);
char *arena_printf(struct arena *a, const char *fmt, ...) ERR_PRINTF(2, 3);
void arena_free(struct arena *a); /* idempotent; keeps limit_bytes, zeroes the rest */

/* ---- buf.c: a byte string that grows and remembers a failure ---- */

struct buf { /* {0} is valid */
    uint8_t *data;
    size_t size, cap;
    /* an append ran out of memory; later appends do nothing; check once at the end */
    bool failed;
};
void buf_add(struct buf *b, const void *bytes, size_t n);
void buf_u8(struct buf *b, unsigned v);
void buf_u16(struct buf *b, unsigned v); /* little-endian, as are all below */
void buf_u32(struct buf *b, uint32_t v);
void buf_u64(struct buf *b, uint64_t v);
void buf_f32(struct buf *b, float v);
void buf_f64(struct buf *b, double v);
void buf_printf(struct buf *b, const char *fmt, ...)
    ERR_PRINTF(2, 3); /* appends a NUL that size does not count */
/* Appends text for HTML or XML, also inside a quoted attribute. & < > " ' become entities. Control
 * characters that XML cannot hold are left out. NULL appends nothing. */
void buf_markup(struct buf *b, const char *text);
/* Adds n bytes to the size and returns where they begin. NULL: out of memory. */
uint8_t *buf_grow(struct buf *b, size_t n);
/* ERR_MEM if an append failed */
enum err_code buf_check(const struct buf *b, struct err *e) ERR_USE;
void buf_free(struct buf *b);

/* A reader of bytes from outside. A read past the end returns 0 and sets `bad`, so one check a
 * record is enough. */
struct cursor {
    const uint8_t *p, *end;
    bool bad;
};
struct cursor cursor_over(const void *bytes, size_t n);
size_t cursor_left(const struct cursor *c);
/* returns NULL and sets `bad` when fewer bytes are left */
const uint8_t *cursor_take(struct cursor *c, size_t n);
uint8_t cursor_u8(struct cursor *c);
uint16_t cursor_u16(struct cursor *c);
uint32_t cursor_u32(struct cursor *c);
uint64_t cursor_u64(struct cursor *c);
float cursor_f32(struct cursor *c);
double cursor_f64(struct cursor *c);

/* ---- file.c: reads and writes whole files ---- */

/* Reads all of `path`. Free `out` with buf_free. limit_bytes 0 means 8 GiB. ERR_NOENT, ERR_IO,
 * ERR_LIMIT (the file is larger than the limit), ERR_MEM. */
enum err_code file_read(const char *path, size_t limit_bytes, struct buf *out,
                        struct err *e) ERR_USE;
/* Writes `path.part-MACHINE-PID`, syncs it and renames it to `path`. On ERR_IO or ERR_LIMIT the new
 * file is removed and an older file of that name stays as it was. MACHINE is 4 hex digits of a hash
 * of the machine's name and the namespace of its processes. */
enum err_code file_write(const char *path, const void *bytes, size_t n, struct err *e) ERR_USE;
/* file_write in steps, for libraries that want a path or a stream. file_begin gives the name to
 * write to. file_commit syncs and renames that file. file_abort removes it. `part` has
 * FILE_PATH_MAX bytes. ERR_LIMIT (path too long), ERR_IO. */
enum { FILE_PATH_MAX = 4096 };
enum err_code file_begin(const char *path, char *part, struct err *e) ERR_USE;
enum err_code file_commit(const char *part, const char *path, struct err *e) ERR_USE;
void file_abort(const char *part);
/* A process that is killed leaves the file or folder that it was writing. file_sweep removes those
 * of `path` whose process of this machine is gone; whoever begins a large output calls it.
 * file_sweep_locked removes all such files of a folder; the caller holds a lock that all of its
 * writers take. Both log each name. What cannot be removed stays. */
void file_sweep(const char *path);
void file_sweep_locked(const char *dir);
/* Removes a file, or a folder with all that it holds. Links are not followed. What cannot be
 * removed, or is not there, is no error. */
void file_remove_tree(const char *path);
/* Reads or writes n bytes at an offset of an open file, all of them. `name` is for the message. Any
 * thread. ERR_IO; ERR_FORMAT: the file ends before. */
enum err_code file_read_at(int fd, const char *name, void *out, size_t n, uint64_t at,
                           struct err *e) ERR_USE;
enum err_code file_write_at(int fd, const char *name, const void *bytes, size_t n, uint64_t at,
                            struct err *e) ERR_USE;
/* Makes a folder and its parents. ERR_IO names the folder and the reason. ERR_ARG: the name is
 * empty or too long. */
enum err_code file_mkdir(const char *path, struct err *e) ERR_USE;
/* Checks that the disk has room for a file or folder of so many bytes at `path`, and logs how much
 * is needed and free. ERR_IO: the disk has less room. If the free space is not known, it returns
 * ERR_OK. */
enum err_code file_room(const char *path, uint64_t bytes, struct err *e) ERR_USE;
/* Checks that only the owner and a group may read a file with a secret, and only the owner may
 * change it. `option` is for the message. ERR_ARG: others may. ERR_NOENT, ERR_IO. */
enum err_code file_check_secret(const char *path, const char *option, struct err *e) ERR_USE;
bool file_exists(const char *path);
bool file_is_dir(const char *path);
/* Returns whether both names lead to one file that exists: also by links. */
bool file_same(const char *a, const char *b);
/* Joins "dir/name" into `out` [FILE_PATH_MAX]. ERR_LIMIT: too long. */
enum err_code file_join(char *out, const char *dir, const char *name, struct err *e) ERR_USE;
/* Lists the regular files of `dir` whose name ends in one of the suffixes, without regard to case.
 * `suffixes` ends with NULL; NULL itself means all files. Names are without the folder, and sorted
 * by their bytes. They live in the arena. ERR_NOENT, ERR_IO, ERR_MEM. */
enum err_code file_list(const char *dir, const char *const *suffixes, struct arena *a,
                        char ***names, size_t *n, struct err *e) ERR_USE;

/* ---- log.c ---- */

enum log_level { LOG_ERROR, LOG_WARN, LOG_INFO, LOG_DEBUG };
void log_set_level(enum log_level level); /* call before threads start */
enum log_level log_get_level(void);
/* Writes lines as JSON: {"ts","level","module","msg"}. Call it before threads start. */
void log_set_json(bool json);
bool log_is_json(void);
/* What a line on stderr begins with where stderr is the journal: "<3>" and so on (sd-daemon(3)).
 * Elsewhere "". */
const char *log_priority(enum log_level level);
/* Writes the current time in UTC as RFC 3339, with milliseconds. */
void log_now(char out[32]);
/* Writes `text` as the inside of a JSON string, with a NUL. It is cut at `room` bytes. Returns the
 * length. */
size_t log_quote(const char *text, char *out, size_t room);
/* Writes one line to stderr: "12.41 info train step n=1200 loss=0.0812". It has elapsed seconds,
 * level, module, event and key=value pairs. Keys contain the unit. */
void log_line(enum log_level level, const char *module, const char *fmt, ...) ERR_PRINTF(3, 4);
/* log_line in two steps, for callers that collect many lines. log_compose returns the length of the
 * line with its newline, or 0 when the level is off. log_write writes bytes to stderr unchanged. */
size_t log_compose(char *line, size_t room, enum log_level level, const char *module,
                   const char *fmt, ...) ERR_PRINTF(5, 6);
void log_write(const char *lines, size_t n);
/* From now on a thread of its own writes the log lines, from a bounded queue. A slow reader of
 * stderr then blocks no other thread. Lines that do not fit are dropped and counted. Call it before
 * other threads start. ERR_MEM. */
enum err_code log_start(struct err *e) ERR_USE;
/* Writes the lines that are left in the queue, and waits at most wait_s + 1 seconds for this. Later
 * calls of log_line write directly again, unless stderr still hangs. Call it after other threads
 * have ended. */
void log_stop(double wait_s);
#define log_error(module, ...) log_line(LOG_ERROR, module, __VA_ARGS__)
#define log_warn(module, ...) log_line(LOG_WARN, module, __VA_ARGS__)
#define log_info(module, ...) log_line(LOG_INFO, module, __VA_ARGS__)
#define log_debug(module, ...) log_line(LOG_DEBUG, module, __VA_ARGS__)

/* ---- progress.c: shows rate and time left of long work ---- */

struct progress {     /* only one thread updates it */
    const char *what; /* what is done, "train level 1"; borrowed for the lifetime */
    uint64_t total, done;
    double start_s, last_s;
    bool tty, active;
};
void progress_start(struct progress *p, const char *what, uint64_t total);
/* Updates the count. `note` (may be NULL) is appended: "loss 0.08, 41 k Gaussians". It prints at
 * most 10 times a second on a terminal, and a line every 5 s elsewhere, so it may be called often.
 */
void progress_step(struct progress *p, uint64_t done, const char *note);
void progress_end(struct progress *p, const char *note);
void progress_quiet(bool quiet); /* -q: shows nothing; call before threads start */

/* ---- clock.c ---- */

double clock_s(void);     /* monotonic seconds */
double clock_cpu_s(void); /* CPU seconds of the whole process, all threads */
/* CPU seconds of child processes that have ended, and of theirs. */
double clock_children_s(void);
/* Days from 1970-01-01 to a date of the Gregorian calendar, from the year 1 on. month: 1 to 12. */
int64_t clock_days(int64_t year, int64_t month, int64_t day);

/* ---- signals.c: the stop flag ---- */

/* SIGINT, SIGTERM and SIGHUP set the flag. A second SIGINT or SIGTERM ends the process. SIGHUP
 * stays ignored where it is (nohup). Call it before threads start. */
void signals_catch(void);
/* Returns whether the flag is set. Any thread. */
bool signals_stopping(void);

/* ---- rng.c: random numbers from counters, so the order of threads does not matter ---- */

/* Returns 64 random bits for (seed, stream, index). They are the same on every machine. */
uint64_t rng_u64(uint64_t seed, uint64_t stream, uint64_t index);
double rng_unit(uint64_t seed, uint64_t stream, uint64_t index); /* uniform in [0, 1), 53 bits */
double rng_normal(uint64_t seed, uint64_t stream,
                  uint64_t index); /* standard normal (Box-Muller) */

/* ---- hash.c: XXH3-128 (libxxhash) ---- */

struct hash128 {
    uint64_t lo, hi;
};
struct hash128 hash_bytes(const void *bytes, size_t n);
/* hash_bytes for bytes that come in pieces. hash_end frees the state. If memory is short,
 * hash_begin returns NULL; the other calls accept that, and the hash is 0. */
struct hash_state;
struct hash_state *hash_begin(void);
void hash_add(struct hash_state *s, const void *bytes, size_t n);
struct hash128 hash_end(struct hash_state *s);
void hash_text(struct hash128 h, char out[33]); /* 32 lower-case hex digits and NUL */

/* ---- number.c: numbers in texts, in the C locale ---- */

/* Reads a finite decimal number, "-1.5e3", with space before it, and moves *p behind it. False:
 * there is none; then *out is 0. */
bool number_read(const char **p, double *out);
/* Reads a text of n numbers with commas between and nothing behind. False: it is none. */
bool number_list(const char *text, size_t n, double *out);

/* ---- base64.c: RFC 4648 ---- */

enum base64_form {
    BASE64_PADDED, /* with + and /, and = at the end */
    BASE64_URL     /* with - and _, and nothing at the end */
};
/* Writes n bytes as text with a NUL, at most base64_room(n) bytes. Returns its length. */
size_t base64_write(const void *bytes, size_t n, enum base64_form form, char *out);
size_t base64_room(size_t n);
/* Reads BASE64_URL. False: it is no such text of exactly n bytes. */
bool base64_read(const char *text, void *out, size_t n);

/* ---- jsonc.c: JSON with // comments on lines of their own, by jansson ---- */

/* Reads and parses JSON. Duplicate keys are errors. Messages name file, line and column. Release
 * *out with json_decref. ERR_FORMAT, ERR_MEM; jsonc_read also ERR_NOENT, ERR_IO, ERR_LIMIT. */
enum err_code jsonc_read(const char *path, struct json_t **out, struct err *e) ERR_USE;
enum err_code jsonc_parse(const char *text, size_t n, const char *name, struct json_t **out,
                          struct err *e) ERR_USE;
/* Writes with file_write. Lines are indented by 2, numbers have 17 digits, keys keep the order of
 * insertion. ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code jsonc_write(const char *path, const struct json_t *json, struct err *e) ERR_USE;
/* Read a member of a given type. ERR_FORMAT: it is missing or of another type; the message is
 * "NAME: key: expected number". */
enum err_code jsonc_num(const struct json_t *o, const char *key, double *out,
                        struct err *e) ERR_USE;
enum err_code jsonc_nums(const struct json_t *o, const char *key, size_t n, double *out,
                         struct err *e) ERR_USE;
enum err_code jsonc_text(const struct json_t *o, const char *key, const char **out,
                         struct err *e) ERR_USE; /* borrowed from o */
/* Checks that an object has no other keys than these; `known` ends with NULL. ERR_DATA: the message
 * is "WHAT takes no 'key'; it takes a, b". */
enum err_code jsonc_known(const struct json_t *o, const char *const *known, const char *what,
                          struct err *e) ERR_USE;
/* A number for json_pack's "o". It is null if v is not finite, because JSON has no such number. */
struct json_t *jsonc_real(double v);

#ifdef __cplusplus
}
#endif
#endif
