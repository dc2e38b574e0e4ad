/* A file is "KEY.program": 8 bytes of magic, the key, the hash of the program, the program. The
 * hash is checked before a driver sees the program, because drivers do not survive damaged ones.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/device/programs.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { PROGRAMS_LIMIT = 64 << 20, PROGRAMS_FORGET_S = 30 * 86400, PROGRAMS_TOUCH_S = 86400 };

static const char programs_end[] = ".program";
static const char programs_magic[8] = "CSprog1\n";

struct programs_head {
    char magic[8];
    struct hash128 key, content;
};

static bool programs_ours(const struct stat *st)
{
    return st->st_uid == getuid() && !(st->st_mode & (S_IWGRP | S_IWOTH));
}

bool programs_folder(const char *dir)
{
    struct stat st;
    if (mkdir(dir, 0700) != 0 && errno != EEXIST)
        return false;
    return lstat(dir, &st) == 0 && S_ISDIR(st.st_mode) && programs_ours(&st) &&
           access(dir, R_OK | W_OK | X_OK) == 0;
}

static enum err_code programs_path(const char *dir, struct hash128 key, char *out, struct err *e)
{
    char text[33], name[33 + sizeof programs_end];
    hash_text(key, text);
    snprintf(name, sizeof name, "%s%s", text, programs_end);
    return file_join(out, dir, name, e);
}

bool programs_read(const char *dir, struct hash128 key, struct buf *out)
{
    char path[FILE_PATH_MAX];
    struct programs_head h;
    struct stat st;
    if (programs_path(dir, key, path, NULL) || lstat(path, &st) != 0 || !S_ISREG(st.st_mode) ||
        !programs_ours(&st) || file_read(path, PROGRAMS_LIMIT, out, NULL))
        return false;
    bool good = out->size > sizeof h;
    if (good) {
        memcpy(&h, out->data, sizeof h);
        struct hash128 found = hash_bytes(out->data + sizeof h, out->size - sizeof h);
        good = !memcmp(h.magic, programs_magic, sizeof h.magic) &&
               !memcmp(&h.key, &key, sizeof key) && !memcmp(&h.content, &found, sizeof found);
    }
    if (!good) {
        buf_free(out);
        return false;
    }
    out->size -= sizeof h;
    memmove(out->data, out->data + sizeof h, out->size);
    if (time(NULL) - st.st_mtime > PROGRAMS_TOUCH_S)
        (void)utimensat(AT_FDCWD, path, NULL, 0); /* it is in use: programs_tidy leaves it */
    return true;
}

/* Removes what is old, and of the rest the oldest if there are too many. Other processes do the
 * same at the same time: a file that is gone already is no error. */
static void programs_tidy(const char *dir)
{
    const size_t tail = sizeof programs_end - 1;
    const time_t now = time(NULL);
    char oldest[64] = "";
    time_t oldest_s = 0;
    size_t n = 0;
    DIR *d = opendir(dir);
    for (struct dirent *f; d && (f = readdir(d));) {
        struct stat st;
        const size_t length = strlen(f->d_name);
        if (fstatat(dirfd(d), f->d_name, &st, AT_SYMLINK_NOFOLLOW) || !S_ISREG(st.st_mode))
            continue;
        if (now - st.st_mtime > PROGRAMS_FORGET_S) { /* also half a file of a killed process */
            (void)unlinkat(dirfd(d), f->d_name, 0);
            continue;
        }
        if (length <= tail || length >= sizeof oldest ||
            strcmp(f->d_name + length - tail, programs_end) != 0)
            continue;
        n++;
        if (!oldest[0] || st.st_mtime < oldest_s) {
            oldest_s = st.st_mtime;
            memcpy(oldest, f->d_name, length + 1);
        }
    }
    if (d && n > PROGRAMS_KEPT) /* each write adds one file and removes one */
        (void)unlinkat(dirfd(d), oldest, 0);
    if (d)
        closedir(d);
}

enum err_code programs_write(const char *dir, struct hash128 key, const void *bytes, size_t n,
                             struct err *e)
{
    char path[FILE_PATH_MAX];
    struct programs_head h = {.key = key, .content = hash_bytes(bytes, n)};
    struct buf file = {0};
    memcpy(h.magic, programs_magic, sizeof h.magic);
    buf_add(&file, &h, sizeof h);
    buf_add(&file, bytes, n);
    enum err_code rc = buf_check(&file, e);
    if (!rc)
        rc = programs_path(dir, key, path, e);
    if (!rc)
        rc = file_write(path, file.data, file.size, e);
    buf_free(&file);
    if (!rc)
        programs_tidy(dir);
    return rc;
}
