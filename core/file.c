/* Reads and writes whole files. A file is written under another name, synced and renamed. A reader
 * never sees half of one, and a full disk leaves the old file unchanged. POSIX calls are used
 * instead of stdio, so that fault injection reaches them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "core/base.h"

enum { FILE_CHUNK = 1 << 30 };

static enum err_code file_read_fd(int fd, const char *path, size_t limit, struct buf *out,
                                  struct err *e)
{
    struct stat st;
    if (fstat(fd, &st))
        return err_errno(e, ERR_IO, "%s", path);
    if (S_ISDIR(st.st_mode))
        return err_set(e, ERR_IO, "%s: is a folder, a file is expected", path);
    if (st.st_size > 0 && (uint64_t)st.st_size > limit)
        return err_set(e, ERR_LIMIT, "%s: %lld bytes, at most %zu are read", path,
                       (long long)st.st_size, limit);
    /* The size is a hint (pipes have none): read until the end. */
    size_t step = st.st_size > 0 ? (size_t)st.st_size + 1 : 65536;
    for (;;) {
        size_t old = out->size;
        uint8_t *p = buf_grow(out, step);
        if (!p)
            return err_set(e, ERR_MEM, "%s: out of memory for %zu bytes", path, old + step);
        ssize_t got = read(fd, p, step > FILE_CHUNK ? FILE_CHUNK : step);
        out->size = old + (got > 0 ? (size_t)got : 0);
        if (got < 0 && errno == EINTR)
            continue;
        if (got < 0)
            return err_errno(e, ERR_IO, "%s", path);
        if (got == 0)
            return ERR_OK;
        if (out->size > limit)
            return err_set(e, ERR_LIMIT, "%s: more than %zu bytes", path, limit);
        if (step > (size_t)got)
            step -= (size_t)got;
        else
            step = 65536;
    }
}

enum err_code file_read(const char *path, size_t limit_bytes, struct buf *out, struct err *e)
{
    if (!limit_bytes)
        limit_bytes = (size_t)8 << 30;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s", path);
    enum err_code rc = file_read_fd(fd, path, limit_bytes, out, e);
    close(fd);
    if (rc)
        buf_free(out);
    return rc;
}

enum err_code file_read_at(int fd, const char *name, void *out, size_t n, uint64_t at,
                           struct err *e)
{
    for (char *p = out; n;) {
        const ssize_t got = pread(fd, p, n > FILE_CHUNK ? FILE_CHUNK : n, (off_t)at);
        if (got < 0 && errno == EINTR)
            continue;
        if (got < 0)
            return err_errno(e, ERR_IO, "%s: cannot read", name);
        if (got == 0)
            return err_set(e, ERR_FORMAT, "%s: truncated: it ends at byte %llu", name,
                           (unsigned long long)at);
        p += got;
        at += (uint64_t)got;
        n -= (size_t)got;
    }
    return ERR_OK;
}

enum err_code file_write_at(int fd, const char *name, const void *bytes, size_t n, uint64_t at,
                            struct err *e)
{
    for (const char *p = bytes; n;) {
        const ssize_t put = pwrite(fd, p, n > FILE_CHUNK ? FILE_CHUNK : n, (off_t)at);
        if (put < 0 && errno == EINTR)
            continue;
        if (put <= 0)
            return err_errno(e, ERR_IO, "%s: cannot write", name);
        p += put;
        at += (uint64_t)put;
        n -= (size_t)put;
    }
    return ERR_OK;
}

/* ---- under another name until it is complete ---- */

static const char file_part[] = ".part-";

enum { FILE_MACHINE = 4 }; /* digits */

/* The machine is in the name because folders are shared: a process of another one that writes there
 * must not be taken for a dead one of this. Containers may share the machine's name, and not its
 * processes. */
static void file_machine(char out[FILE_MACHINE + 1])
{
    char name[512] = "", hex[33];
    (void)gethostname(name, 255);
    size_t n = strlen(name);
    const ssize_t more = readlink("/proc/self/ns/pid", name + n, sizeof name - n);
    n += more > 0 ? (size_t)more : 0;
    hash_text(hash_bytes(name, n), hex);
    memcpy(out, hex, FILE_MACHINE);
    out[FILE_MACHINE] = '\0';
}

enum err_code file_begin(const char *path, char *part, struct err *e)
{
    char machine[FILE_MACHINE + 1];
    file_machine(machine);
    int n = snprintf(part, FILE_PATH_MAX, "%s%s%s-%ld", path, file_part, machine, (long)getpid());
    if (n < 0 || n >= FILE_PATH_MAX)
        return err_set(e, ERR_LIMIT, "%s: path too long", path);
    return ERR_OK;
}

/* Whether this follows the name of a file that a process of this machine began and that process is
 * gone; machine NULL: whether any process began it. Libraries append to the names that they are
 * given: "-journal", ".ovr.tmp". */
static bool file_is_left(const char *name, const char *machine)
{
    const size_t n = sizeof file_part - 1;
    char *end;
    if (strncmp(name, file_part, n) != 0 || strspn(name + n, "0123456789abcdef") != FILE_MACHINE ||
        name[n + FILE_MACHINE] != '-' || (machine && memcmp(name + n, machine, FILE_MACHINE) != 0))
        return false;
    const long pid = strtol(name + n + FILE_MACHINE + 1, &end, 10);
    return pid > 0 && (!*end || *end == '-' || *end == '.') &&
           (!machine || (kill((pid_t)pid, 0) && errno == ESRCH));
}

/* What was left in `dir` by writers of `name`; NULL: of all that it holds, whether they run or not.
 */
static void file_sweep_in(const char *dir, const char *name)
{
    char machine[FILE_MACHINE + 1], path[FILE_PATH_MAX];
    struct stat st;
    const size_t n = name ? strlen(name) : 0;
    file_machine(machine);
    DIR *d = opendir(dir);
    for (struct dirent *ent; d && (ent = readdir(d));) {
        const char *part = strstr(ent->d_name, file_part);
        const bool left =
            name ? !strncmp(ent->d_name, name, n) && file_is_left(ent->d_name + n, machine)
                 : part && file_is_left(part, NULL);
        if (!left || file_join(path, dir, ent->d_name, NULL))
            continue;
        file_remove_tree(path);
        if (lstat(path, &st))
            log_info("disk", "%s was left by a run that was killed: removed", path);
    }
    if (d)
        closedir(d);
}

void file_sweep(const char *path)
{
    char dir[FILE_PATH_MAX];
    const char *slash = strrchr(path, '/');
    const size_t n = slash ? (size_t)(slash - path) + 1 : 0;
    if (n >= sizeof dir)
        return;
    memcpy(dir, path, n);
    dir[n] = '\0';
    file_sweep_in(n ? dir : ".", path + n);
}

void file_sweep_locked(const char *dir)
{
    file_sweep_in(dir, NULL);
}

static int file_remove_entry(const char *path, const struct stat *st, int type, struct FTW *at)
{
    (void)st;
    (void)type;
    (void)at;
    (void)remove(path);
    return 0;
}

void file_remove_tree(const char *path)
{
    (void)nftw(path, file_remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

static enum err_code file_sync(const char *path, struct err *e)
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return err_errno(e, ERR_IO, "%s", path);
    int bad = fsync(fd);
    int why = errno;
    close(fd);
    errno = why;
    return bad ? err_errno(e, ERR_IO, "%s: cannot sync", path) : ERR_OK;
}

enum err_code file_commit(const char *part, const char *path, struct err *e)
{
    enum err_code rc = file_sync(part, e);
    if (!rc && rename(part, path))
        rc = err_errno(e, ERR_IO, "%s: cannot rename into place", path);
    if (rc)
        file_abort(part);
    return rc;
}

void file_abort(const char *part)
{
    (void)unlink(part);
}

static enum err_code file_put(int fd, const char *path, const uint8_t *p, size_t n, struct err *e)
{
    while (n > 0) {
        ssize_t put = write(fd, p, n > FILE_CHUNK ? FILE_CHUNK : n);
        if (put < 0 && errno == EINTR)
            continue;
        if (put < 0)
            return err_errno(e, ERR_IO, "%s: cannot write", path);
        p += put;
        n -= (size_t)put;
    }
    return ERR_OK;
}

enum err_code file_write(const char *path, const void *bytes, size_t n, struct err *e)
{
    char part[FILE_PATH_MAX];
    enum err_code rc = file_begin(path, part, e);
    if (rc)
        return rc;
    int fd = open(part, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0)
        return err_errno(e, ERR_IO, "%s: cannot create", path);
    rc = file_put(fd, path, bytes, n, e);
    if (close(fd) && !rc)
        rc = err_errno(e, ERR_IO, "%s: cannot close", path);
    if (rc) {
        file_abort(part);
        return rc;
    }
    return file_commit(part, path, e);
}

/* A size for people. */
static void file_size_text(uint64_t bytes, char out[32])
{
    double b = (double)bytes;
    snprintf(out, 32, b < 1e9 ? "%.1f MB" : "%.1f GB", b < 1e9 ? b / 1e6 : b / 1e9);
}

enum err_code file_room(const char *path, uint64_t bytes, struct err *e)
{
    char dir[FILE_PATH_MAX], need[32], have[32];
    struct statvfs fs;
    snprintf(dir, sizeof dir, "%s", path);
    char *slash = strrchr(dir, '/');
    if (slash)
        slash[slash == dir] = '\0';
    if (statvfs(slash ? dir : ".", &fs))
        return ERR_OK;
    uint64_t left = (uint64_t)fs.f_bavail * fs.f_frsize;
    file_size_text(bytes, need);
    file_size_text(left, have);
    if (left < bytes)
        return err_set(e, ERR_IO,
                       "%s: %s are needed on the disk, %s are free; make room, or write elsewhere",
                       path, need, have);
    log_info("disk", "%s: %s are needed, %s are free", path, need, have);
    return ERR_OK;
}

enum err_code file_mkdir(const char *path, struct err *e)
{
    char step[FILE_PATH_MAX];
    size_t n = strlen(path);
    if (!n || n >= sizeof step)
        return err_set(e, ERR_ARG, "folder name is empty or too long");
    memcpy(step, path, n + 1);
    for (size_t i = 1; i <= n; i++) {
        if (step[i] != '/' && step[i] != '\0')
            continue;
        char keep = step[i];
        step[i] = '\0';
        if (mkdir(step, 0777) && errno != EEXIST)
            return err_errno(e, ERR_IO, "%s: cannot make the folder", step);
        step[i] = keep;
    }
    if (!file_is_dir(path))
        return err_set(e, ERR_IO, "%s: exists and is not a folder", path);
    return ERR_OK;
}

enum err_code file_check_secret(const char *path, const char *option, struct err *e)
{
    struct stat st;
    if (stat(path, &st))
        return err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s %s", option, path);
    if (st.st_mode & (S_IWGRP | S_IRWXO))
        return err_set(e, ERR_ARG,
                       "%s %s: others may read or change it: chmod 600 it, or 640 with the "
                       "group of the service",
                       option, path);
    return ERR_OK;
}

bool file_exists(const char *path)
{
    struct stat st;
    return stat(path, &st) == 0;
}

bool file_is_dir(const char *path)
{
    struct stat st;
    return stat(path, &st) == 0 && S_ISDIR(st.st_mode);
}

bool file_same(const char *a, const char *b)
{
    struct stat x, y;
    return stat(a, &x) == 0 && stat(b, &y) == 0 && x.st_dev == y.st_dev && x.st_ino == y.st_ino;
}

enum err_code file_join(char *out, const char *dir, const char *name, struct err *e)
{
    size_t n = strlen(dir);
    const char *slash = n && dir[n - 1] == '/' ? "" : "/";
    int m = snprintf(out, FILE_PATH_MAX, "%s%s%s", dir, slash, name);
    if (m < 0 || m >= FILE_PATH_MAX)
        return err_set(e, ERR_LIMIT, "%s: path too long", name);
    return ERR_OK;
}

static bool file_has_suffix(const char *name, const char *const *suffixes)
{
    if (!suffixes)
        return true;
    size_t n = strlen(name);
    for (; *suffixes; suffixes++) {
        size_t m = strlen(*suffixes);
        if (n >= m && !strcasecmp(name + n - m, *suffixes))
            return true;
    }
    return false;
}

static int file_compare(const void *a, const void *b)
{
    const char *const *x = a;
    const char *const *y = b;
    return strcmp(*x, *y);
}

/* One pass over the folder: counts when names is NULL, fills up to `cap` otherwise. */
static enum err_code file_scan(const char *dir, const char *const *suffixes, struct arena *a,
                               char **names, size_t cap, size_t *n, struct err *e)
{
    DIR *d = opendir(dir);
    if (!d)
        return err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s", dir);
    enum err_code rc = ERR_OK;
    *n = 0;
    for (struct dirent *ent; !rc && (ent = readdir(d));) {
        char path[FILE_PATH_MAX];
        if (ent->d_name[0] == '.' || !file_has_suffix(ent->d_name, suffixes) ||
            file_join(path, dir, ent->d_name, NULL) || file_is_dir(path))
            continue;
        if (names && *n < cap) {
            names[*n] = arena_text(a, ent->d_name);
            if (!names[*n])
                rc = err_set(e, ERR_MEM, "%s: out of memory", dir);
        }
        *n += 1;
    }
    closedir(d);
    return rc;
}

enum err_code file_list(const char *dir, const char *const *suffixes, struct arena *a,
                        char ***names, size_t *n, struct err *e)
{
    size_t cap = 0;
    enum err_code rc = file_scan(dir, suffixes, a, NULL, 0, &cap, e);
    if (rc)
        return rc;
    char **list = arena_get(a, cap + 1, sizeof *list);
    if (!list)
        return err_set(e, ERR_MEM, "%s: out of memory", dir);
    size_t found = 0;
    rc = file_scan(dir, suffixes, a, list, cap, &found, e);
    if (rc)
        return rc;
    *n = found < cap ? found : cap;
    qsort(list, *n, sizeof *list, file_compare);
    *names = list;
    return ERR_OK;
}
