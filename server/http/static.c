/* The viewer's files, read once at the start into a sorted table. A request finds a path among
 * names that were read from disk before, and never reaches the file system. Names with a hash
 * (Vite's assets/) are immutable. Text is also kept as brotli and gzip, from x.js.br and x.js.gz of
 * the viewer's build, because making them would delay the start. If there is no x.js.gz, it is
 * made. Of large text only these forms are kept: nearly all clients take one of them, and without
 * them the viewer is three times as large.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/static.h"

#include <dirent.h>
#include <libdeflate.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { FILES_MAX = 4096, DEPTH_MAX = 8, PLAIN_MAX = 64 << 10 };
static const size_t BYTES_MAX = (size_t)256 << 20;

static const struct {
    const char *suffix, *type;
    bool text;
} types[] = {
    {".html", "text/html; charset=utf-8", true},
    {".js", "text/javascript; charset=utf-8", true},
    {".mjs", "text/javascript; charset=utf-8", true},
    {".css", "text/css; charset=utf-8", true},
    {".json", "application/json", true},
    {".map", "application/json", true},
    {".svg", "image/svg+xml", true},
    {".txt", "text/plain; charset=utf-8", true},
    {".wasm", "application/wasm", true},
    {".webmanifest", "application/manifest+json", true},
    {".png", "image/png", false},
    {".jpg", "image/jpeg", false},
    {".webp", "image/webp", false},
    {".ico", "image/x-icon", false},
    {".woff2", "font/woff2", false},
    {".glb", "model/gltf-binary", false},
};

static int static_type_of(const char *name)
{
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && i < sizeof types / sizeof *types; i++)
        if (!strcmp(dot, types[i].suffix))
            return (int)i;
    return -1;
}

/* Bytes that a legal request path can hold: other names could never be asked for. */
static bool static_plain_name(const char *name)
{
    return name[0] != '.' &&
           !name[strspn(name, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                              "0123456789_.,@:-")];
}

/* Whether the build made this file of another one that is beside it: x.js.br of x.js. */
static bool static_is_coded(const char *path)
{
    char plain[FILE_PATH_MAX];
    size_t n = strlen(path);
    if (n < 4 || n >= sizeof plain || (strcmp(path + n - 3, ".br") && strcmp(path + n - 3, ".gz")))
        return false;
    memcpy(plain, path, n - 3);
    plain[n - 3] = 0;
    return file_exists(plain);
}

/* The file at path as it was compressed beside it, into *data, where that is there and shorter. One
 * that is older than a file whose name does not change with its bytes is of other bytes. */
static enum err_code static_read_coded(const char *path, const char *suffix,
                                       const struct static_file *f, uint8_t **data, size_t *size,
                                       size_t *bytes, struct err *e)
{
    char coded[FILE_PATH_MAX];
    struct stat st;
    struct buf b = {0};
    if (snprintf(coded, sizeof coded, "%s%s", path, suffix) >= (int)sizeof coded ||
        stat(coded, &st) || !S_ISREG(st.st_mode) ||
        (!f->immutable && st.st_mtime < f->body->modified_s))
        return ERR_OK;
    enum err_code rc = file_read(coded, BYTES_MAX, &b, e);
    if (!rc && b.size && b.size < f->body->size) {
        *data = b.data;
        *size = b.size;
        *bytes += b.size;
        return ERR_OK;
    }
    buf_free(&b);
    return rc;
}

static enum err_code static_add_coded(const char *path, const struct static_file *f, size_t *bytes,
                                      struct err *e)
{
    struct body *b = f->body;
    enum err_code rc = static_read_coded(path, ".br", f, &b->brotli, &b->brotli_size, bytes, e);
    if (!rc)
        rc = static_read_coded(path, ".gz", f, &b->gzip, &b->gzip_size, bytes, e);
    if (!rc && !b->gzip)
        body_compress(b);
    b->coded = b->gzip || b->brotli;
    return rc;
}

/* Does the gzip form end with the checksum and the size of the plain one (RFC 1952)? */
static bool static_is_of(const struct body *b)
{
    enum { END = 8 };
    if (b->gzip_size < END)
        return false;
    struct cursor end = cursor_over(b->gzip + b->gzip_size - END, END);
    const uint32_t crc = cursor_u32(&end), size = cursor_u32(&end);
    return size == (uint32_t)b->size && crc == libdeflate_crc32(0, b->data, b->size);
}

/* Pages stay: they are made again with a preview of their scene. */
static void static_leave_plain(const struct static_file *f)
{
    struct body *b = f->body;
    if (b->size < PLAIN_MAX || !strncmp(f->type, "text/html", 9) || !static_is_of(b))
        return;
    mem_free(b->data);
    b->data = NULL;
}

/* Vite's names: /assets/NAME-HASH.EXT, 8 of A-Z a-z 0-9 _ -; other files of a folder of one's own
 * change. */
static bool static_has_hash(const char *url)
{
    const char *dot = strrchr(url, '.');
    return !strncmp(url, "/assets/", 8) && dot && dot - url > 8 + 9 && dot[-9] == '-';
}

static enum err_code static_add_file(const char *dir, const char *url, int64_t modified_s,
                                     struct static_table *t, size_t *bytes, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct buf b = {0};
    struct static_file *file = mem_room(t->file, t->n, &t->cap, 32, sizeof *file);
    if (!file)
        return err_set(e, ERR_MEM, "%s: out of memory", dir);
    t->file = file;
    if (t->n == FILES_MAX)
        return err_set(e, ERR_LIMIT, "%s: more than %d files", dir, FILES_MAX);
    enum err_code rc = file_join(path, dir, url + 1, e);
    if (!rc)
        rc = file_read(path, BYTES_MAX, &b, e);
    if (rc)
        return rc;
    *bytes += b.size;
    int type = static_type_of(url);
    struct static_file f = {
        .path = mem_text(url),
        .type = type < 0 ? "application/octet-stream" : types[type].type,
        .immutable = static_has_hash(url),
        .body = body_take(&b, NULL),
    };
    if (!f.path || !f.body) {
        mem_free(f.path);
        body_drop(&f.body);
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    }
    f.body->modified_s = modified_s;
    snprintf(f.digest, sizeof f.digest, "%012llx",
             (unsigned long long)(hash_bytes(f.body->data, f.body->size).lo & 0xffffffffffff));
    t->file[t->n++] = f;
    if (type >= 0 && types[type].text) {
        rc = static_add_coded(path, &f, bytes, e);
        if (rc)
            return rc;
        static_leave_plain(&f);
    }
    return *bytes > BYTES_MAX ? err_set(e, ERR_LIMIT, "%s: more than %zu bytes", dir, BYTES_MAX)
                              : ERR_OK;
}

/* All files below dir + url, depth first. */
static enum err_code static_add_dir(const char *dir, const char *url, int depth,
                                    struct static_table *t, size_t *bytes, struct err *e)
{
    char path[FILE_PATH_MAX], below[FILE_PATH_MAX];
    enum err_code rc = ERR_OK;
    if (depth > DEPTH_MAX)
        return err_set(e, ERR_LIMIT, "%s: folders nested deeper than %d", dir, DEPTH_MAX);
    if (snprintf(path, sizeof path, "%s%s", dir, url) >= (int)sizeof path)
        return err_set(e, ERR_LIMIT, "%s: path too long", dir);
    DIR *d = opendir(path);
    if (!d)
        return err_errno(e, ERR_IO, "%s: cannot list this folder", path);
    for (struct dirent *x; !rc && (x = readdir(d));) {
        struct stat st;
        if (!static_plain_name(x->d_name))
            continue;
        if (snprintf(below, sizeof below, "%s%s%s", url, url[1] ? "/" : "", x->d_name) >=
                (int)sizeof below ||
            snprintf(path, sizeof path, "%s%s", dir, below) >= (int)sizeof path)
            rc = err_set(e, ERR_LIMIT, "%s: path too long", dir);
        else if (stat(path, &st) != 0)
            continue; /* gone since readdir, or a dangling link */
        else if (S_ISDIR(st.st_mode))
            rc = static_add_dir(dir, below, depth + 1, t, bytes, e);
        else if (S_ISREG(st.st_mode) && !static_is_coded(path))
            rc = static_add_file(dir, below, st.st_mtime, t, bytes, e);
    }
    closedir(d);
    return rc;
}

static int static_by_path(const void *a, const void *b)
{
    return strcmp(((const struct static_file *)a)->path, ((const struct static_file *)b)->path);
}

enum err_code static_load(const char *dir, struct static_table *out, struct err *e)
{
    size_t bytes = 0;
    memset(out, 0, sizeof *out);
    enum err_code rc = static_add_dir(dir, "/", 0, out, &bytes, e);
    if (rc)
        static_free(out);
    else if (out->n)
        qsort(out->file, out->n, sizeof *out->file, static_by_path);
    return rc;
}

void static_free(struct static_table *t)
{
    for (size_t i = 0; i < t->n; i++) {
        mem_free(t->file[i].path);
        body_drop(&t->file[i].body);
    }
    mem_free(t->file);
    memset(t, 0, sizeof *t);
}

const struct static_file *static_find(const struct static_table *t, const char *path, size_t n)
{
    size_t lo = 0, hi = t->n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        int order = strncmp(t->file[mid].path, path, n);
        if (!order && t->file[mid].path[n])
            order = 1;
        if (!order)
            return &t->file[mid];
        if (order < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return NULL;
}

struct body *static_plain(const struct static_file *f)
{
    const struct body *b = f->body;
    struct libdeflate_decompressor *d = libdeflate_alloc_decompressor();
    struct buf plain = {.data = mem_uninit(b->size, 1), .size = b->size, .cap = b->size};
    bool whole = d && plain.data &&
                 libdeflate_gzip_decompress(d, b->gzip, b->gzip_size, plain.data, plain.size,
                                            NULL) == LIBDEFLATE_SUCCESS;
    libdeflate_free_decompressor(d);
    struct body *out = whole ? body_take(&plain, NULL) : NULL;
    buf_free(&plain);
    if (out && strcmp(out->etag, b->etag) != 0)
        body_drop(&out); /* the form is of other bytes */
    if (!out)
        return NULL;
    out->coded = true;
    out->modified_s = b->modified_s;
    return out;
}

bool static_default_dir(char out[FILE_PATH_MAX])
{
    static const char *const places[] = {"../../web/dist", "../web/dist", "../share/citysplat/web"};
    char self[FILE_PATH_MAX];
    ssize_t n = readlink("/proc/self/exe", self, sizeof self - 1);
    if (n <= 0)
        return false;
    self[n] = 0;
    *strrchr(self, '/') = 0;
    for (size_t i = 0; i < sizeof places / sizeof *places; i++) {
        char index[FILE_PATH_MAX];
        if (snprintf(out, FILE_PATH_MAX, "%s/%s", self, places[i]) < FILE_PATH_MAX &&
            snprintf(index, sizeof index, "%s/index.html", out) < (int)sizeof index &&
            file_exists(index))
            return true;
    }
    return false;
}
