/* What a folder of results holds when a server starts: see disk_scan.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/disk_scan.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int disk_scan_by_use(const void *a, const void *b)
{
    const struct timespec *x = &((const struct disk_scan_file *)a)->used,
                          *y = &((const struct disk_scan_file *)b)->used;
    return x->tv_sec != y->tv_sec     ? (x->tv_sec < y->tv_sec ? -1 : 1)
           : x->tv_nsec != y->tv_nsec ? (x->tv_nsec < y->tv_nsec ? -1 : 1)
                                      : 0;
}

/* Of "ab" and "cdef...": false for names that are none of ours. */
static bool disk_scan_name(const char *folder, const char *name, struct hash128 *id)
{
    char text[33], half[17] = "";
    if (strlen(name) != 30 || strspn(name, "0123456789abcdef") != 30)
        return false;
    memcpy(text, folder, 2);
    memcpy(text + 2, name, 31);
    id->lo = strtoull(text + 16, NULL, 16);
    memcpy(half, text, 16); /* the higher one first, as hash_text has it */
    id->hi = strtoull(half, NULL, 16);
    return true;
}

static enum err_code disk_scan_add(struct disk_scan *s, struct disk_scan_file f, struct err *e)
{
    struct disk_scan_file *more = mem_room(s->file, s->n, &s->cap, 1024, sizeof *s->file);
    if (!more)
        return err_set(e, ERR_MEM, "disk cache: out of memory for its list of files");
    s->file = more;
    s->file[s->n++] = f;
    return ERR_OK;
}

/* One of the 256 folders. */
static enum err_code disk_scan_folder(const char *all, unsigned i, struct disk_scan *s,
                                      struct err *e)
{
    char folder[3], path[FILE_PATH_MAX];
    snprintf(folder, sizeof folder, "%02x", i & 0xff);
    enum err_code rc = file_join(path, all, folder, e);
    if (rc)
        return err_add(e, "--cache-dir");
    if (mkdir(path, 0700) && errno != EEXIST)
        return err_errno(e, ERR_IO, "--cache-dir: %s", path);
    DIR *dir = opendir(path);
    if (!dir)
        return err_errno(e, ERR_IO, "--cache-dir: %s", path);
    for (struct dirent *f; !rc && (f = readdir(dir));) {
        struct disk_scan_file found;
        struct stat st;
        const size_t size = strlen(f->d_name);
        if (size > 5 && !strcmp(f->d_name + size - 5, ".part"))
            (void)unlinkat(dirfd(dir), f->d_name, 0);
        else if (disk_scan_name(folder, f->d_name, &found.id) &&
                 !fstatat(dirfd(dir), f->d_name, &st, AT_SYMLINK_NOFOLLOW) && S_ISREG(st.st_mode)) {
            found.bytes = (uint64_t)st.st_size;
            found.used = st.st_mtim;
            found.mode = st.st_mode & 0700;
            rc = disk_scan_add(s, found, e);
        }
    }
    closedir(dir);
    return rc;
}

enum err_code disk_scan_dir(const char *dir, struct disk_scan *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    *out = (struct disk_scan){0};
    for (unsigned i = 0; !rc && i < 256; i++)
        rc = disk_scan_folder(dir, i, out, e);
    if (!rc && out->n)
        qsort(out->file, out->n, sizeof *out->file, disk_scan_by_use);
    return rc;
}

void disk_scan_free(struct disk_scan *s)
{
    mem_free(s->file);
    *s = (struct disk_scan){0};
}
