/* 3TZ archives: see package.h.
 *
 * libzip does not say where an entry will lie. The index is therefore written as zeros first, last
 * of all entries; offsets are read from the central directory, and index and its CRC are put in
 * place before the file gets its name.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/package.h"

#include <fcntl.h>
#include <nettle/md5.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zip.h>
#include <zlib.h>

enum {
    PACKAGE_DATE = 0x21, /* 1980-01-01 as MS-DOS has it */
    PACKAGE_ROW = 24,
    PACKAGE_END = 22, /* bytes of the zip's last record, without a comment */
    PACKAGE_LOCATOR = 20,
    PACKAGE_END64 = 56,
    PACKAGE_ENTRY = 46, /* of the central directory */
    PACKAGE_LOCAL = 30
};

/* ---- the zip ---- */

static enum err_code package_add(zip_t *z, const char *name, zip_source_t *from, struct err *e)
{
    if (!from)
        return err_set(e, ERR_MEM, "zip: %s: %s", name, zip_strerror(z));
    zip_int64_t at = zip_file_add(z, name, from, ZIP_FL_ENC_UTF_8);
    if (at < 0) {
        zip_source_free(from);
        return err_set(e, ERR_MEM, "zip: %s: %s", name, zip_strerror(z));
    }
    return zip_set_file_compression(z, (zip_uint64_t)at, ZIP_CM_STORE, 0) ||
                   zip_file_set_dostime(z, (zip_uint64_t)at, 0, PACKAGE_DATE, 0)
               ? err_set(e, ERR_INTERNAL, "zip: %s: %s", name, zip_strerror(z))
               : ERR_OK;
}

static int package_cancel(zip_t *z, void *user)
{
    (void)z, (void)user;
    return signals_stopping();
}

static enum err_code package_close(zip_t *z, const char *part, struct err *e)
{
    zip_register_cancel_callback_with_state(z, package_cancel, NULL, NULL);
    if (zip_close(z) == 0)
        return ERR_OK;
    const int why = zip_error_code_zip(zip_get_error(z));
    enum err_code rc = why == ZIP_ER_CANCELLED ? err_set(e, ERR_CANCEL, "stopped")
                                               : err_set(e, why == ZIP_ER_MEMORY ? ERR_MEM : ERR_IO,
                                                         "%s: zip: %s", part, zip_strerror(z));
    zip_discard(z);
    return rc;
}

/* All files, and an index of zeros, which is borrowed. */
static enum err_code package_zip(const char *dir, char *const *names, size_t n, const char *part,
                                 const struct buf *index, struct err *e)
{
    int why;
    char path[FILE_PATH_MAX];
    enum err_code rc = ERR_OK;
    zip_t *z = zip_open(part, ZIP_CREATE | ZIP_TRUNCATE, &why);
    if (!z)
        return err_set(e, ERR_IO, "%s: cannot create a zip archive (libzip's error %d)", part, why);
    for (size_t i = 0; !rc && i < n; i++) {
        rc = file_join(path, dir, names[i], e);
        if (!rc && !file_exists(path))
            rc = err_set(e, ERR_NOENT, "%s: there is no such file", path);
        if (!rc)
            rc = package_add(z, names[i], zip_source_file(z, path, 0, -1), e);
    }
    if (!rc)
        rc = package_add(z, PACKAGE_INDEX, zip_source_buffer(z, index->data, index->size, 0), e);
    if (!rc)
        return package_close(z, part, e);
    zip_discard(z);
    return rc;
}

/* ---- the index ---- */

struct package_directory { /* the zip's own */
    uint64_t at, size, n;
};

/* Where it is, by the records at the end. */
static enum err_code package_find(int fd, const char *part, struct package_directory *out,
                                  struct err *e)
{
    uint8_t end[PACKAGE_LOCATOR + PACKAGE_END], end64[PACKAGE_END64];
    struct stat st;
    if (fstat(fd, &st))
        return err_errno(e, ERR_IO, "%s", part);
    const uint64_t size = (uint64_t)st.st_size;
    if (size < sizeof end)
        return err_set(e, ERR_INTERNAL, "%s: no zip archive was written", part);
    enum err_code rc = file_read_at(fd, part, end, sizeof end, size - sizeof end, e);
    struct cursor c = cursor_over(end + PACKAGE_LOCATOR, PACKAGE_END);
    const bool found = !rc && cursor_u32(&c) == 0x06054b50;
    if (!rc && !found)
        rc = err_set(e, ERR_INTERNAL, "%s: the zip archive does not end as it should", part);
    if (rc)
        return rc;
    c = cursor_over(end + PACKAGE_LOCATOR + 10, PACKAGE_END - 10);
    out->n = cursor_u16(&c);
    out->size = cursor_u32(&c);
    out->at = cursor_u32(&c);
    c = cursor_over(end, PACKAGE_LOCATOR);
    if (cursor_u32(&c) != 0x07064b50) /* no ZIP64 */
        return ERR_OK;
    (void)cursor_u32(&c);
    rc = file_read_at(fd, part, end64, sizeof end64, cursor_u64(&c), e);
    c = cursor_over(end64 + 32, PACKAGE_END64 - 32);
    if (!rc) {
        out->n = cursor_u64(&c);
        out->size = cursor_u64(&c);
        out->at = cursor_u64(&c);
    }
    return rc;
}

struct package_entry {
    uint64_t offset; /* of the local header */
    const uint8_t *name;
    size_t n_name;
    size_t at; /* in the central directory */
};

/* The next entry; false where the directory makes no sense. */
static bool package_next(const uint8_t *bytes, size_t size, size_t *at, struct package_entry *out)
{
    if (size - *at < PACKAGE_ENTRY)
        return false;
    struct cursor c = cursor_over(bytes + *at, PACKAGE_ENTRY);
    const bool good = cursor_u32(&c) == 0x02014b50;
    c = cursor_over(bytes + *at + 20, PACKAGE_ENTRY - 20);
    const uint32_t packed = cursor_u32(&c), plain = cursor_u32(&c);
    const size_t n_name = cursor_u16(&c), n_extra = cursor_u16(&c), n_comment = cursor_u16(&c);
    c = cursor_over(bytes + *at + 42, 4);
    *out = (struct package_entry){
        .offset = cursor_u32(&c), .name = bytes + *at + PACKAGE_ENTRY, .n_name = n_name, .at = *at};
    if (!good || size - *at - PACKAGE_ENTRY < n_name + n_extra + n_comment)
        return false;
    /* ZIP64: of sizes and offset, those that have no room above, in this order */
    const size_t skip = 8 * ((plain == UINT32_MAX) + (size_t)(packed == UINT32_MAX));
    bool known = out->offset != UINT32_MAX;
    for (size_t i = 0; !known && i + 4 <= n_extra;) {
        c = cursor_over(out->name + n_name + i, n_extra - i);
        const uint32_t id = cursor_u16(&c), n = cursor_u16(&c);
        if (id == 1 && n >= skip + 8 && i + 4 + n <= n_extra) {
            c = cursor_over(out->name + n_name + i + 4 + skip, 8);
            out->offset = cursor_u64(&c);
            known = true;
        }
        i += 4 + n;
    }
    *at += PACKAGE_ENTRY + n_name + n_extra + n_comment;
    return known;
}

static uint64_t package_u64(const uint8_t *p)
{
    struct cursor c = cursor_over(p, 8);
    return cursor_u64(&c);
}

static int package_by_hash(const void *a, const void *b)
{
    for (size_t i = 0; i < 16; i += 8) {
        const uint64_t x = package_u64((const uint8_t *)a + i),
                       y = package_u64((const uint8_t *)b + i);
        if (x != y)
            return x < y ? -1 : 1;
    }
    return 0;
}

/* The rows of all entries but the last, which is the index itself. */
static enum err_code package_rows(const uint8_t *directory, size_t size, size_t n,
                                  struct buf *index, struct package_entry *last, struct err *e)
{
    size_t at = 0;
    for (size_t i = 0; i <= n; i++) {
        if (!package_next(directory, size, &at, last))
            return err_set(e, ERR_INTERNAL, "zip: entry %zu of its directory makes no sense", i);
        if (i == n)
            break;
        struct md5_ctx md5;
        uint8_t *row = index->data + i * PACKAGE_ROW;
        md5_init(&md5);
        md5_update(&md5, last->n_name, last->name);
        md5_digest(&md5, 16, row);
        for (int k = 0; k < 8; k++)
            row[16 + k] = (uint8_t)(last->offset >> (8 * k));
    }
    if (last->n_name != strlen(PACKAGE_INDEX) || memcmp(last->name, PACKAGE_INDEX, last->n_name))
        return err_set(e, ERR_INTERNAL, "zip: the index is not the last entry");
    qsort(index->data, n, PACKAGE_ROW, package_by_hash);
    for (size_t i = 1; i < n; i++)
        if (!package_by_hash(index->data + (i - 1) * PACKAGE_ROW, index->data + i * PACKAGE_ROW))
            return err_set(e, ERR_INTERNAL, "zip: two files have one name, or one MD5 of it");
    return ERR_OK;
}

/* Index and CRC in the place of the zeros. */
static enum err_code package_put(int fd, const char *part, const struct package_directory *d,
                                 const struct package_entry *last, const struct buf *index,
                                 struct err *e)
{
    uint8_t local[PACKAGE_LOCAL], crc[4];
    const uint32_t sum = (uint32_t)crc32_z(0, index->data, index->size);
    for (int k = 0; k < 4; k++)
        crc[k] = (uint8_t)(sum >> (8 * k));
    enum err_code rc = file_read_at(fd, part, local, sizeof local, last->offset, e);
    struct cursor c = cursor_over(local + 26, 4);
    const uint32_t n_name = cursor_u16(&c), n_extra = cursor_u16(&c);
    if (!rc && (local[6] & 8)) /* sizes and CRC behind the data: not as libzip writes files */
        rc = err_set(e, ERR_INTERNAL, "%s: the index has no CRC in its head", part);
    if (!rc)
        rc = file_write_at(fd, part, crc, sizeof crc, last->offset + 14, e);
    if (!rc)
        rc = file_write_at(fd, part, crc, sizeof crc, d->at + last->at + 16, e);
    return rc ? rc
              : file_write_at(fd, part, index->data, index->size,
                              last->offset + PACKAGE_LOCAL + n_name + n_extra, e);
}

static enum err_code package_index(const char *part, size_t n, struct buf *index, struct err *e)
{
    struct package_directory d = {0};
    struct package_entry last = {0};
    uint8_t *bytes = NULL;
    int fd = open(part, O_RDWR | O_CLOEXEC);
    if (fd < 0)
        return err_errno(e, ERR_IO, "%s", part);
    enum err_code rc = package_find(fd, part, &d, e);
    if (!rc && d.n != n + 1)
        rc = err_set(e, ERR_INTERNAL, "%s: %llu entries, %zu were written", part,
                     (unsigned long long)d.n, n + 1);
    if (!rc && !(bytes = mem_array(d.size ? d.size : 1, 1)))
        rc = err_set(e, ERR_MEM, "zip: out of memory for the directory of %zu files", n);
    if (!rc)
        rc = file_read_at(fd, part, bytes, d.size, d.at, e);
    if (!rc)
        rc = package_rows(bytes, d.size, n, index, &last, e);
    if (!rc)
        rc = package_put(fd, part, &d, &last, index, e);
    mem_free(bytes);
    if (close(fd) && !rc)
        rc = err_errno(e, ERR_IO, "%s", part);
    return rc;
}

enum err_code package_write(const char *dir, char *const *names, size_t n, const char *path,
                            struct err *e)
{
    char part[FILE_PATH_MAX];
    struct buf index = {0};
    uint8_t *room = buf_grow(&index, n * PACKAGE_ROW);
    if (room)
        memset(room, 0, n * PACKAGE_ROW);
    enum err_code rc = buf_check(&index, e);
    if (!rc)
        rc = file_begin(path, part, e);
    if (rc) {
        buf_free(&index);
        return rc;
    }
    rc = package_zip(dir, names, n, part, &index, e);
    if (!rc)
        rc = package_index(part, n, &index, e);
    if (!rc)
        rc = file_commit(part, path, e);
    if (rc)
        file_abort(part);
    buf_free(&index);
    return rc;
}
