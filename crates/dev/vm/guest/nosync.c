/* Loaded in front of the C library, this makes every sync a lie: the negative control of the power cuts. */
int fsync(int file) { (void)file; return 0; }
int fdatasync(int file) { (void)file; return 0; }
int syncfs(int file) { (void)file; return 0; }
int sync_file_range(int file, long offset, long length, unsigned flags) {
  (void)file, (void)offset, (void)length, (void)flags;
  return 0;
}
void sync(void) {}
