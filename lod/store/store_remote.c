/* An SQLite file system over remote objects: sqlite.org/vfs.html. Nothing is written, locked or
 * made; files are immutable, and so opened (immutable=1). Why a read failed is asked of the reader.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/store_remote.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lod/store/remote.h"

struct store_remote_file {
    sqlite3_file base;
    struct remote *remote;
};

static int store_remote_close(sqlite3_file *f)
{
    remote_close(&((struct store_remote_file *)f)->remote);
    return SQLITE_OK;
}

static int store_remote_read(sqlite3_file *f, void *out, int n, sqlite3_int64 at)
{
    struct remote *r = ((struct store_remote_file *)f)->remote;
    const uint64_t size = remote_size(r);
    if (at < 0 || (uint64_t)at + (uint64_t)n > size) {
        memset(out, 0, (size_t)n);
        return SQLITE_IOERR_SHORT_READ;
    }
    const enum err_code rc = remote_read(r, (uint64_t)at, out, (size_t)n, NULL);
    return rc == ERR_MEM ? SQLITE_IOERR_NOMEM : rc ? SQLITE_IOERR_READ : SQLITE_OK;
}

/* NOLINTNEXTLINE(readability-non-const-parameter): SQLite's type */
static int store_remote_write(sqlite3_file *f, const void *bytes, int n, sqlite3_int64 at)
{
    (void)f, (void)bytes, (void)n, (void)at;
    return SQLITE_READONLY;
}

static int store_remote_truncate(sqlite3_file *f, sqlite3_int64 size)
{
    (void)f, (void)size;
    return SQLITE_READONLY;
}

static int store_remote_size(sqlite3_file *f, sqlite3_int64 *out)
{
    *out = (sqlite3_int64)remote_size(((struct store_remote_file *)f)->remote);
    return SQLITE_OK;
}

static int store_remote_flag(sqlite3_file *f, int flag) /* of sync, lock, unlock */
{
    (void)f, (void)flag;
    return SQLITE_OK;
}

static int store_remote_locked(sqlite3_file *f, int *out)
{
    (void)f;
    *out = 0;
    return SQLITE_OK;
}

static int store_remote_control(sqlite3_file *f, int op, void *arg)
{
    (void)f, (void)op, (void)arg;
    return SQLITE_NOTFOUND;
}

static int store_remote_sector(sqlite3_file *f)
{
    (void)f;
    return 0; /* the usual */
}

static int store_remote_traits(sqlite3_file *f)
{
    (void)f;
    return SQLITE_IOCAP_IMMUTABLE;
}

static const sqlite3_io_methods store_remote_methods = {
    .iVersion = 1,
    .xClose = store_remote_close,
    .xRead = store_remote_read,
    .xWrite = store_remote_write,
    .xTruncate = store_remote_truncate,
    .xSync = store_remote_flag,
    .xFileSize = store_remote_size,
    .xLock = store_remote_flag,
    .xUnlock = store_remote_flag,
    .xCheckReservedLock = store_remote_locked,
    .xFileControl = store_remote_control,
    .xSectorSize = store_remote_sector,
    .xDeviceCharacteristics = store_remote_traits,
};

static int store_remote_open(sqlite3_vfs *vfs, const char *path, sqlite3_file *f, int flags,
                             int *out_flags)
{
    static const char fds[] = "/proc/self/fd/";
    struct store_remote_file *file = (struct store_remote_file *)f;
    char *end = NULL;
    (void)vfs;
    f->pMethods = NULL;
    if (!path || !(flags & SQLITE_OPEN_MAIN_DB) || strncmp(path, fds, sizeof fds - 1))
        return SQLITE_CANTOPEN; /* temporary files stay in memory */
    const long fd = strtol(path + sizeof fds - 1, &end, 10);
    const enum err_code rc = *end ? ERR_ARG : remote_attach((int)fd, &file->remote, NULL);
    if (rc)
        return rc == ERR_MEM ? SQLITE_NOMEM : SQLITE_CANTOPEN;
    if (out_flags)
        *out_flags = SQLITE_OPEN_READONLY | SQLITE_OPEN_MAIN_DB;
    f->pMethods = &store_remote_methods;
    return SQLITE_OK;
}

static int store_remote_delete(sqlite3_vfs *vfs, const char *path, int sync)
{
    (void)vfs, (void)path, (void)sync;
    return SQLITE_READONLY;
}

static int store_remote_access(sqlite3_vfs *vfs, const char *path, int flags, int *out)
{
    (void)vfs, (void)path, (void)flags;
    *out = 0; /* there are no journals */
    return SQLITE_OK;
}

static int store_remote_path(sqlite3_vfs *vfs, const char *path, int room, char *out)
{
    (void)vfs;
    return snprintf(out, (size_t)room, "%s", path) < room ? SQLITE_OK : SQLITE_CANTOPEN;
}

static sqlite3_vfs store_remote_files;

/* Clock, random numbers and the rest are those of the usual file system. */
static void store_remote_add(void)
{
    const sqlite3_vfs *usual = sqlite3_vfs_find(NULL);
    if (!usual)
        return;
    store_remote_files = *usual;
    store_remote_files.pNext = NULL;
    store_remote_files.zName = "citysplat-remote";
    store_remote_files.szOsFile = sizeof(struct store_remote_file);
    store_remote_files.xOpen = store_remote_open;
    store_remote_files.xDelete = store_remote_delete;
    store_remote_files.xAccess = store_remote_access;
    store_remote_files.xFullPathname = store_remote_path;
    sqlite3_vfs_register(&store_remote_files, 0);
}

const char *store_remote_vfs(void)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, store_remote_add);
    return store_remote_files.zName;
}

struct remote *store_remote_of(sqlite3 *db)
{
    sqlite3_file *f = NULL;
    if (sqlite3_file_control(db, "main", SQLITE_FCNTL_FILE_POINTER, &f) != SQLITE_OK || !f ||
        f->pMethods != &store_remote_methods)
        return NULL;
    return ((struct store_remote_file *)f)->remote;
}
