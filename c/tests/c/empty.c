/* An empty program: shows whether a compiler and its sanitizers are installed. */
int main(void)
{
    return 0;
}
